"""One claim of the paper: the result here, and whether it is as expected; docs/paper.md has the claims."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """Verdict on a claim; all but NO are as expected."""

    YES = "yes"
    LIMITED = "within a limit"
    MISPRINT = "misprint"
    NO = "NO"


@dataclass(frozen=True)
class Claim:
    """A claim; `verdict` compares the figures of `ours` with bounds on both sides."""

    key: str
    ours: str
    verdict: Verdict


@dataclass(frozen=True)
class Effort:
    """Extent of the simulations: samples of a long run, cases of a sweep, seconds of a recording."""

    samples: int
    cases: int
    recording_s: float


FULL = Effort(samples=10_000_000, cases=2000, recording_s=1.0)
FAST = Effort(samples=200_000, cases=200, recording_s=0.3)

Maker = Callable[[Effort], Iterator[Claim]]


def verdict(holds: bool, otherwise: Verdict = Verdict.YES) -> Verdict:
    return otherwise if holds else Verdict.NO


def percent(part: float, digits: int = 3) -> str:
    """``part`` (of a cycle or anything else) in per cent."""
    return f"{100.0 * part:.{digits}g} %"


def grouped(number: float) -> str:
    return f"{number:,.0f}".replace(",", " ")
