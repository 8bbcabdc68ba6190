"""A page of tables and pictures: one HTML file that refers to nothing outside of itself, without script."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from html import escape

from canfb.report import style as css
from canfb.rows import Row


def page(title: str, place: str, said: Sequence[str], body: str, footer: str, good: bool = True) -> str:
    """The whole page. All but ``body`` is plain text.

    place    below the title: when, where
    said     the verdict, its first line in bold; at least one line
    body     HTML, of the functions below
    good     the verdict is a good one
    """
    first, *others = (_unbroken(escape(line)) for line in said)
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{css.COLOURS}{css.DRAWING}{css.PAGE}</style>\n</head>\n"
        f'<body>\n<h1>{escape(title)}</h1>\n<p class="where">{escape(place)}</p>\n'
        f'<div class="verdict{"" if good else " bad"}"><p><strong>{first}</strong></p>'
        f"{''.join(f'<p>{line}</p>' for line in others)}</div>\n"
        f"{body}<footer>{escape(footer)}</footer>\n</body>\n</html>\n"
    )


def _unbroken(text: str) -> str:
    """No line ends within an option."""
    return re.sub(r"(?<![\w-])--[\w-]+", r'<span class="option">\g<0></span>', text)


def beside(left: str, right: str) -> str:
    """Two parts side by side; one below the other on a narrow screen."""
    return f'<div class="top"><div>{left}</div>\n{right}</div>\n'


def gallery(title: str, figures: Iterable[str]) -> str:
    """Figures in two columns; in one on a narrow screen."""
    return f'<h2>{escape(title)}</h2>\n<div class="pictures">\n{"".join(figures)}</div>\n'


def figure(name: str, text: str, picture: str) -> str:
    """A picture with its caption: ``name`` in bold, and ``text``."""
    caption = f"<figcaption>{escape(name)}<small>{escape(text)}</small></figcaption>"
    return f"<figure>{caption}{picture}</figure>\n"


def table(title: str, rows: Iterable[Row], heads: Sequence[str] = (), style: str = "") -> str:
    """The rows that have words: their names, and the words in columns, below ``heads`` if there are any.

    ``style`` is a CSS class; "listed", for cells with much text: on a narrow screen it is a list, each name
    with its cells below.
    """
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
