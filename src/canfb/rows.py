"""What a command found, as rows: one list is printed, drawn as a table of a page, and given to programs.

A row is one fact. Its name and its words are for people; its figures, plain values by their JSON keys with
the unit in the key, are for programs::

    Row("largest jerk", "18100 rad/s³, 0.02 cycle per interval³", jerk_rad_s3=18123.4, jerk_cycles=0.0201)

    as_lines      terminal: the name, then its words
    as_columns    terminal: several words side by side, below their heads
    as_figures    JSON: the figures of all rows
    page.table    HTML

A row whose words are None is for programs alone: a value that is not known is null there, and not printed.
So the three outputs have the same facts, and a fact that is added is added to all of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

NAME_WIDTH = 24  # of the names of most commands, characters


class Row:
    """One fact: a name, "" if it goes on from the row above; its words, one for each column; its figures."""

    __slots__ = ("figures", "name", "words")

    def __init__(self, name: str = "", /, *words: str | None, **figures: Any) -> None:
        self.name = name
        self.words: tuple[str, ...] = tuple(word for word in words if word is not None)
        self.figures = figures


@dataclass(frozen=True)
class Result:
    """What a command hands back: plain values for ``--json``, lines for people."""

    figures: Any
    lines: list[str]


def as_figures(*lists: Iterable[Row]) -> dict[str, Any]:
    """All figures, in the order of the rows. ValueError for a key that comes twice: one would be lost."""
    found: dict[str, Any] = {}
    for row in (row for rows in lists for row in rows):
        if twice := found.keys() & row.figures:
            raise ValueError(f"figures come twice: {', '.join(sorted(twice))}")
        found |= row.figures
    return found


def as_lines(rows: Iterable[Row], width: int = NAME_WIDTH) -> list[str]:
    """One line for each row that has words: the name in ``width`` characters, then the words."""
    return [f"{row.name:{width}}{' '.join(row.words)}" for row in rows if row.words]


def as_columns(rows: Iterable[Row], heads: Sequence[str], least: Sequence[int] = ()) -> list[str]:
    """Names and words side by side, two spaces apart, below ``heads``; the first head is that of the names.

    Words beyond the heads are left out. ``least`` are the smallest widths of the columns.
    """
    cells = [tuple(heads), *((row.name, *row.words)[: len(heads)] for row in rows if row.words)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    widths = [max(width, *least[n : n + 1], 0) for n, width in enumerate(widths)]
    return [
        "  ".join(f"{cell:{width}}" for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in cells
    ]
