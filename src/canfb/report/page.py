"""Self-contained HTML pages and SVG files, and their CSS."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from html import escape

from canfb.files import as_utf8
from canfb.report.plot import LEFT, Key, Plot
from canfb.rows import Row, Section

COLOURS = """
:root { color-scheme: light dark; --ink: #1c2126; --soft: #5b656e; --paper: #ffffff; --panel: #f6f7f8;
  --rule: #d8dcdf; --before: #b5472f; --after: #14708c; --limit: #6d757c; --good: #1d6b3a; --bad: #a8261b; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e7e9; --soft: #a3acb3; --paper: #15181b;
  --panel: #1e2226; --rule: #3a4046; --before: #f0846a; --after: #5cc0dd; --limit: #9aa3aa; --good: #6fcf8e;
  --bad: #ff8a7d; } }
@media print { :root { color-scheme: light; --ink: #000; --soft: #444; --paper: #fff; --panel: #fff;
  --rule: #bbb; --before: #b5472f; --after: #14708c; --limit: #666; --good: #1d6b3a; --bad: #a8261b; }
}
"""

DRAWING = """
svg { font-family: system-ui, "Segoe UI", Roboto, sans-serif; }
svg text { fill: var(--soft); font-size: 12px; }
svg .label { fill: var(--ink); }
.mid { text-anchor: middle; } .end { text-anchor: end; }
.grid { stroke: var(--rule); stroke-width: .6; } .axis { fill: none; stroke: var(--soft); stroke-width: 1; }
.line { fill: none; stroke-width: 1.7; stroke-linejoin: round; }
.dots { fill: none; stroke-width: 2.6; stroke-linecap: round; stroke-opacity: .8; }
.line.before, .dots.before { stroke: var(--before); } .line.after, .dots.after { stroke: var(--after); }
.line.limit { stroke: var(--limit); } .line.limit, .line.thin { stroke-width: 1.1; }
.dashed { stroke-dasharray: 5 4; }
.dots.large { stroke-width: 4.5; stroke-opacity: 1; }
.ring { fill: none; stroke-width: 1.6; } .ring.before { stroke: var(--before); }
svg .note { paint-order: stroke; stroke: var(--panel); stroke-width: 3px; stroke-linejoin: round; }
svg .note.before { fill: var(--before); }
svg .heading { fill: var(--ink); font-size: 14px; font-weight: 600; }
.panel { fill: var(--panel); }
.bar { stroke: none; } .bar.before { fill: var(--before); } .bar.after { fill: var(--after); }
"""

PAGE = """
body { background: var(--paper); color: var(--ink); font: 15px/1.45 system-ui, "Segoe UI", Roboto, sans-serif;
  margin: 2em auto; max-width: 1120px; padding: 0 1.2em; }
h1 { font-size: 1.5em; margin: 0 0 .2em; }
h2 { font-size: 1.1em; margin: 1.6em 0 .5em; }
.where { color: var(--soft); margin: 0 0 1em; }
.verdict { border-left: 5px solid var(--good); background: var(--panel); padding: .7em 1em; margin: 0 0 .4em;
  font-size: 1.08em; }
.verdict.bad { border-color: var(--bad); }
.verdict p { margin: .15em 0; }
table { border-collapse: collapse; margin: 0 0 1em; }
th, td { text-align: left; padding: .28em 1.4em .28em 0; border-bottom: 1px solid var(--rule);
  vertical-align: top; }
td { font-variant-numeric: tabular-nums; }
.origin td { overflow-wrap: anywhere; }
.option { white-space: nowrap; }
.top table { width: 100%; } .top th, .top td { padding-right: .9em; }
.top thead + tbody td:nth-child(2) { white-space: nowrap; }
thead th { color: var(--soft); font-weight: 600; }
tbody th { font-weight: 500; white-space: nowrap; }
.pictures { display: grid; gap: 1.1em; align-items: start;
  grid-template-columns: repeat(auto-fit, minmax(min(430px, 100%), 1fr)); }
.top { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(430px, 100%), 1fr)); gap: 0 1.6em;
  align-items: start; }
.top figure { margin-top: 1.6em; }
figure { margin: 0; background: var(--panel); border: 1px solid var(--rule); border-radius: 6px;
  padding: .7em .8em .6em; }
figcaption { font-weight: 600; margin-bottom: .35em; }
figcaption small { display: block; font-weight: 400; color: var(--soft); }
svg { width: 100%; height: auto; display: block; }
.legend { display: flex; flex-wrap: wrap; gap: .1em 1.3em; color: var(--soft); font-size: .87em;
  margin: .1em 0 0 3.6em; }
.legend span { display: inline-flex; align-items: center; gap: .45em; }
.legend i { display: inline-block; width: 20px; height: 0; border-top: 2px solid; }
.legend i.bar-key { height: 10px; width: 12px; border: 0; background: currentColor; }
.legend i.dot-key { height: 7px; width: 7px; border: 0; border-radius: 50%; background: currentColor; }
.legend i.ring-key { height: 8px; width: 8px; border: 2px solid; border-radius: 50%; }
.legend i.dashed { border-top-style: dashed; } .legend i.thin { border-top-width: 1px; }
i.before { color: var(--before); } i.after { color: var(--after); } i.limit { color: var(--limit); }
footer { color: var(--soft); font-size: .87em; margin: 2em 0; }
@media (max-width: 560px) {
  body { margin: 1em auto; padding: 0 .8em; } .top th, .top td { padding-right: .6em; }
  tbody th, .top thead + tbody td:nth-child(2) { white-space: normal; } .legend { margin-left: .4em; }
  figure { padding: .6em .3em .5em; } figcaption { padding: 0 .4em; } svg text { font-size: 14px; }
  .listed thead { display: none; } .listed, .listed tbody { display: block; }
  .listed tr { display: grid; grid-template-columns: 1fr 1fr; border-bottom: 1px solid var(--rule);
    padding: .3em 0; }
  .listed th, .listed td { border: 0; padding: .1em .6em .1em 0; } .listed tbody th { font-weight: 600; }
  .listed tbody th, .listed td:nth-child(n + 4) { grid-column: 1 / -1; }
  .listed td::before { content: attr(data-head); display: block; color: var(--soft); font-size: .87em; }
}
@media print { body { margin: 0; padding: 0; font-size: 11px; } figure { break-inside: avoid; }
  h2 { break-after: avoid; } .top, .pictures { grid-template-columns: 1fr 1fr; gap: .6em; }
  figure { padding: .4em; } .top figure { margin-top: .6em; } footer { margin: 1em 0 0; } }
"""


def page(title: str, place: str, said: Sequence[str], body: str, footer: str, good: bool = True) -> str:
    """The whole page; all but ``body`` (HTML) is plain text.

    place    time and place
    said     sentences of the verdict, the first in bold; ``good``: whether it is positive
    """
    first, *others = map(_sentence, said)
    return as_utf8(
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{COLOURS}{DRAWING}{PAGE}</style>\n</head>\n"
        f'<body>\n<h1>{escape(title)}</h1>\n<p class="where">{escape(place)}</p>\n'
        f'<div class="verdict{"" if good else " bad"}"><p><strong>{first}</strong></p>'
        f"{''.join(f'<p>{line}</p>' for line in others)}</div>\n"
        f"{body}<footer>{escape(footer)}</footer>\n</body>\n</html>\n"
    )


def _sentence(line: str) -> str:
    text = escape(f"{line[:1].upper()}{line[1:].removesuffix('.')}.")
    return re.sub(r"(?<![\w-])--[\w-]+", r'<span class="option">\g<0></span>', text)


def beside(left: str, right: str) -> str:
    return f'<div class="top"><div>{left}</div>\n{right}</div>\n'


def gallery(title: str, figures: Iterable[str]) -> str:
    return f'<h2>{escape(title)}</h2>\n<div class="pictures">\n{"".join(figures)}</div>\n'


def figure(name: str, text: str, picture: str) -> str:
    caption = f"<figcaption>{escape(name)}<small>{escape(text)}</small></figcaption>"
    return f"<figure>{caption}{picture}</figure>\n"


def section(one: Section) -> str:
    return table(one.title, one.rows, one.heads, "listed" if one.beside is not None else "")


def table(title: str, rows: Iterable[Row], heads: Sequence[str] = (), style: str = "") -> str:
    """Table of the rows that have words, below ``heads``; ``style`` "listed": for long texts."""
    top = "".join(f"<th>{escape(head)}</th>" for head in heads)
    body = "".join(
        f"<tr><th>{escape(row.name)}</th>{_cells(heads, row.words)}</tr>\n" for row in rows if row.words
    )
    head = f"<thead><tr><th></th>{top}</tr></thead>" if heads else ""
    shape = f' class="{style}"' if style else ""
    return f"<h2>{escape(title)}</h2>\n<table{shape}>{head}<tbody>\n{body}</tbody></table>\n"


def _cells(heads: Sequence[str], words: Sequence[str]) -> str:
    if not heads:
        return "".join(f"<td>{escape(word)}</td>" for word in words)
    pairs = zip(heads, words, strict=True)
    return "".join(f'<td data-head="{escape(head)}">{escape(word)}</td>' for head, word in pairs)


HEADING, ROW, MARGIN = 34.0, 18.0, 10.0  # heights
KEY_WIDTH = 22.0


def svg_file(panels: Sequence[tuple[str, Plot]]) -> str:
    parts: list[str] = []
    height = 0.0
    for heading, plot in panels:
        parts.append(f'<text x="{LEFT:g}" y="{height + 22.0:g}" class="heading">{escape(heading)}</text>')
        height += HEADING
        parts.append(f'<g transform="translate(0 {height:g})">{plot.drawing()}</g>')
        height += plot.height
        for key in plot.legend:
            parts.append(_key(key, height + ROW / 2.0))
            height += ROW
        height += MARGIN
    width = max(plot.width for _, plot in panels)
    title = "; ".join(plot.title for _, plot in panels)
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}" height="{height:g}" '
        f'viewBox="0 0 {width:g} {height:g}" role="img">\n<title>{escape(title)}</title>\n'
        f"<style>{COLOURS}{DRAWING}</style>\n"
        f'<rect class="panel" width="100%" height="100%"/>\n{body}\n</svg>\n'
    )


def _key(key: Key, middle: float) -> str:
    left, centre = LEFT, LEFT + KEY_WIDTH / 2.0
    marks = {
        "line": f'<path class="line {key.style}" d="M{left:g} {middle:g}h{KEY_WIDTH:g}"/>',
        "dot": f'<path class="dots large {key.style}" d="M{centre:g} {middle:g}h0"/>',
        "bar": f'<path class="bar {key.style}" d="M{left + 5.0:g} {middle - 5.0:g}h12v10h-12z"/>',
        "ring": f'<circle class="ring {key.style}" cx="{centre:g}" cy="{middle:g}" r="5"/>',
    }
    words = f'<text x="{left + KEY_WIDTH + 8.0:g}" y="{middle + 4.0:g}">{escape(key.name)}</text>'
    return f"{marks[key.kind]}{words}"
