"""Small parts of Markdown pages: cells, tables, text."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence

FIELD = re.compile(r"^(\w+(?:, \w+)*) {2,}(\S.*)$")
"""A line of a docstring on a field: its name, or several, and what it means."""


def cell(text: object) -> str:
    """One cell of a table: one line, no bar that would end it."""
    return " ".join(str(text).split()).replace("|", "\\|")


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> Iterator[str]:
    """The lines of a table."""
    yield f"| {' | '.join(head)} |"
    yield "|" + " --- |" * len(head)
    for row in rows:
        yield f"| {' | '.join(cell(one) for one in row)} |"


def plain(text: str) -> str:
    """Text of the code that Markdown must not take for markup, in one line; ``x`` becomes `x`."""
    one_line = " ".join(text.split())
    parts = re.split(r"(``.+?``)", re.sub(r":\w+:`~?\.?([^`]+)`", r"``\1``", one_line))
    return "".join(
        f"`{p[2:-2]}`" if p.startswith("``") else re.sub(r"([*_<\[\]])", r"\\\1", p) for p in parts
    )
