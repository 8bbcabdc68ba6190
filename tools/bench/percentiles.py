"""Percentiles of times, and tables of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Self

PARTS = (0.5, 0.99, 0.999)
HEAD = ("p50", "p99", "p99.9", "max")
NOTHING = "-"


@dataclass(frozen=True)
class Percentiles:
    """p50, p99, p99.9 and the largest of ``count`` values; nearest rank, so each is one of them."""

    count: int
    values: tuple[float, ...]

    @classmethod
    def of(cls, values: Iterable[float]) -> Self:
        """ValueError if there are none."""
        ordered = sorted(values)
        if not ordered:
            raise ValueError("no values")
        ranks = (math.ceil(part * len(ordered)) - 1 for part in PARTS)
        return cls(len(ordered), (*(ordered[rank] for rank in ranks), ordered[-1]))

    def cells(self) -> list[str]:
        """For a table."""
        return [f"{value:.0f}" if value >= 10 else f"{value:.1f}" for value in self.values]


def cells(values: Sequence[float]) -> list[str]:
    """Those of the percentiles, or a dash each."""
    return Percentiles.of(values).cells() if values else [NOTHING] * len(HEAD)


def cell(values: Sequence[float]) -> str:
    """All of them in one."""
    return " / ".join(cells(values)) if values else NOTHING


@dataclass
class Table:
    """Rows under a head, as text in columns or as markdown."""

    head: list[str]
    rows: list[list[str]] = field(default_factory=list)

    def text(self) -> str:
        """Columns; the first is flush left."""
        lines = [self.head, *self.rows]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        return "\n".join(
            "  ".join(
                cell.rjust(width) if n else cell.ljust(width)
                for n, (cell, width) in enumerate(zip(line, widths, strict=True))
            )
            for line in lines
        )

    def markdown(self) -> str:
        """As in docs/."""
        lines = [self.head, ["---"] * len(self.head), *self.rows]
        return "\n".join(f"| {' | '.join(line)} |" for line in lines)
