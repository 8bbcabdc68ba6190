"""A page of tables and pictures: one HTML file that refers to nothing outside of itself, without script."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from html import escape

from canfb.report import style


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
        f"<title>{escape(title)}</title>\n<style>{style.COLOURS}{style.DRAWING}{style.PAGE}</style>\n</head>\n"
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


def facts_table(title: str, facts: Iterable[tuple[str, str]], style: str = "") -> str:
    """Names and what there is to say of each; ``style`` is a CSS class."""
    rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>\n" for name, text in facts)
    table = f'<table class="{style}">' if style else "<table>"
    return f"<h2>{escape(title)}</h2>\n{table}<tbody>\n{rows}</tbody></table>\n"


def comparison_table(
    title: str, heads: Sequence[str], rows: Iterable[Sequence[str]], *, listed: bool = False
) -> str:
    """One column for each head behind the names; each row begins with its name.

    ``listed``, for cells with much text: on a narrow screen it is a list, each name with its cells below.
    """
    head = "".join(f"<th>{escape(one)}</th>" for one in heads)
    body = "".join(f"<tr><th>{escape(name)}</th>{_cells(heads, cells)}</tr>\n" for name, *cells in rows)
    shape = ' class="listed"' if listed else ""
    return (
        f"<h2>{escape(title)}</h2>\n<table{shape}><thead><tr><th></th>{head}</tr></thead>"
        f"<tbody>\n{body}</tbody></table>\n"
    )


def _cells(heads: Sequence[str], cells: Sequence[str]) -> str:
    pairs = zip(heads, cells, strict=True)
    return "".join(f'<td data-head="{escape(head)}">{escape(cell)}</td>' for head, cell in pairs)
