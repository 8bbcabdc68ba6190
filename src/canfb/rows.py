"""What a command found, as rows: one list is printed, drawn as a table of a page, and given to programs.

A row is one fact: name and words for people; figures, with the unit in the key, for programs::

    Row("largest jerk", "18100 rad/s³, 0.02 cycle per interval³", jerk_rad_s3=18123.4, jerk_cycles=0.0201)

A row whose words are None is for programs alone. :class:`Findings` are all rows of a command, by subject,
with what is said of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

NAME_WIDTH = 24  # of the names of most commands, characters


class Row:
    """One fact: a name, "" if it continues the row above; its words, one for each column; its figures."""

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


def listed(names: Sequence[str], most: int = 12) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def those(*said: tuple[object, str]) -> list[str]:
    """The texts whose condition holds."""
    return [text for holds, text in said if holds]


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

    Words beyond the heads stand on a line of their own. ``least`` are the smallest widths of the columns.
    """
    shown = [(row.name, *row.words) for row in rows if row.words]
    cells = [tuple(heads), *(one[: len(heads)] for one in shown)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    widths = [max(width, *least[n : n + 1], 0) for n, width in enumerate(widths)]
    lines = []
    for line, below in zip(cells, [(), *(one[len(heads) :] for one in shown)], strict=True):
        padded = "  ".join(f"{cell:{width}}" for cell, width in zip(line, widths, strict=True))
        lines += [padded.rstrip(), *(f"    {word}" for word in below)]
    return lines


@dataclass(frozen=True)
class Section:
    """The rows of one subject.

    heads    of their words, if there are several
    beside   side by side in a terminal, the others below; None: all
    key      of a list with the figures of each row; "": among those of all
    """

    title: str
    rows: Sequence[Row]
    heads: tuple[str, ...] = ()
    beside: int | None = None
    key: str = ""

    def lines(self) -> list[str]:
        if not self.heads:
            return as_lines(self.rows)
        return as_columns(self.rows, ("", *self.heads[: self.beside]), (NAME_WIDTH - 2,))

    def figures(self) -> list[Row]:
        return [Row(**{self.key: [row.figures for row in self.rows]})] if self.key else list(self.rows)


@dataclass(frozen=True)
class Findings:
    """What a command found: ``said`` are sentences, ``figures`` are for programs alone."""

    sections: Sequence[Section]
    said: Sequence[str]
    figures: Sequence[Row]

    def to_json(self) -> dict[str, Any]:
        return as_figures(self.figures, *(section.figures() for section in self.sections))

    def result(self, paths: Iterable[Path] = ()) -> Result:
        lines = [line for section in self.sections for line in (*section.lines(), "")]
        files = [str(path) for path in paths]
        written = [f"written  {path}" for path in files]
        return Result(self.to_json() | {"files": files}, [*lines, *self.said, *written])


def age_words(seconds: float) -> str:
    """0.8 s, 12 min, 3.4 h."""
    if seconds < 100.0:
        return f"{seconds:.1f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"
