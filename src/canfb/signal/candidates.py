"""Ways through a gap: where the position may be after samples that cannot be trusted.

When a sample fails, the samples just before it may have been bad already: a glitch of less
than the residual limit is seen one sample later only. So the position is carried on from
each of the last few samples, each time taking all that followed for bad. The samples that
come decide: the first candidate that meets several of them in a row, closely, is the position.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from canfb.signal.tracker import Track

# How close a candidate must come to a sample one interval after the last: so much, and a multiple
# of what the prediction missed before; at most 5 % of a cycle, 4 times the error of Table 1 and a bit.
CLOSE_CYCLES = 0.008
CLOSE_PER_ROUGHNESS = 2.5
MOST_CLOSE_CYCLES = 0.055
# Samples with any phase must not pass for a position: all candidates together meet a whole row of
# them by chance once in so many faults.
CHANCE = 1e-6
MOST_CANDIDATES = 8


class Place(NamedTuple):
    """One accepted sample: cycle count, phase, and the intervals since the one before."""

    cycles: int
    phase: float
    elapsed: float


class Candidate:
    """The position carried on from one accepted sample, with its speed and a constant acceleration."""

    __slots__ = (
        "_bend",
        "_close",
        "_confirmations",
        "_cycles",
        "_gap",
        "_phase",
        "_step_part",
        "_step_whole",
        "before",
        "confirmed",
        "elapsed",
        "last",
    )

    def __init__(self, places: Sequence[Place], bend: float, close: float) -> None:
        """From the last of ``places``, oldest first, at least one.

        ``bend`` is the acceleration, cycles per interval squared; ``close`` how close it must
        come to a sample one interval later, cycles.
        """
        last = places[-1]
        self._cycles, self._phase = last.cycles, last.phase
        self._step_whole, self._step_part = _step(places, 1)
        self._bend = bend
        self._close = close
        self._confirmations = math.ceil(math.log(CHANCE / MOST_CANDIDATES) / math.log(2.0 * close))
        self._gap = 0.0
        self.confirmed = 0
        self.elapsed = 1.0  # intervals between ``before`` and ``last``
        self.before = self.last = Track(last.cycles, last.phase, 0.0, True)

    @property
    def gap(self) -> float:
        """Intervals since the sample that it stands on."""
        return self._gap

    @property
    def proven(self) -> bool:
        """True when it met enough samples in a row."""
        return self.confirmed >= self._confirmations

    def predict(self) -> Track:
        """The position where it is now; never ok."""
        cycles, part = self._ahead()
        turns = math.floor(part)
        phase = part - turns
        if phase >= 1.0:
            turns, phase = turns + 1, 0.0
        return Track(cycles + turns, phase, 0.5, False)

    def wait(self, elapsed: float) -> None:
        """Let ``elapsed`` intervals pass without a sample to meet."""
        self._gap += elapsed

    def meet(self, phase: float) -> bool:
        """A sample with this phase now: taken if it is close. False for a proven miss.

        Before the first close sample a miss only means that this sample is bad as well;
        after it, that the candidate was wrong.
        """
        cycles, part = self._ahead()
        c = part - phase
        turns = round(c)
        residual = abs(turns - c)
        # What the last two phases were off by grows with the gap that they are extrapolated over.
        if residual > self._close * (self._gap + 1.0) / 2.0:
            return self.confirmed == 0
        self._take(cycles + turns, phase, residual)
        return True

    def _ahead(self) -> tuple[int, float]:
        gap = self._gap
        way = self._step_whole * gap
        whole = math.floor(way)
        bend = self._bend * gap * (gap + 1.0) / 2.0
        return self._cycles + whole, self._phase + (way - whole) + self._step_part * gap + bend

    def _take(self, cycles: int, phase: float, residual: float) -> None:
        gap = self._gap
        way, part = cycles - self._cycles, phase - self._phase
        # Mean speed over the gap, and half of the acceleration's part of it, is the speed at its end.
        speed_whole = way // math.ceil(gap) if gap.is_integer() else math.floor(way / gap)
        rest = (way - speed_whole * gap + part) / gap + self._bend * (gap - 1.0) / 2.0
        carry = math.floor(rest)
        self._step_whole, self._step_part = speed_whole + carry, rest - carry
        self._cycles, self._phase, self._gap = cycles, phase, 0.0
        self.elapsed = gap
        self.before, self.last = self.last, Track(cycles, phase, residual, True)
        self.confirmed += 1


def _step(places: Sequence[Place], back: int) -> tuple[int, float]:
    """Speed between two neighbouring places, cycles per interval, split into whole and part."""
    if len(places) <= back:
        return 0, 0.0
    new, old = places[-back], places[-back - 1]
    way, part = new.cycles - old.cycles, new.phase - old.phase
    whole = math.floor(way / new.elapsed)
    return whole, (way - whole * new.elapsed + part) / new.elapsed


def candidates(places: Sequence[Place], doubted: int) -> list[Candidate]:
    """Candidates that take the last ``doubted`` of ``places`` for bad.

    One at constant speed, and one that goes on to accelerate, if the machine did: nobody
    knows whether it ends just now.
    """
    trusted, bad = places[: len(places) - doubted], places[len(places) - doubted :]
    bends = _bends(trusted)
    mean = sum(bends) / len(bends) if bends else 0.0
    rough = max((abs(bend - mean) for bend in bends), default=1.0)
    close = min(CLOSE_CYCLES + CLOSE_PER_ROUGHNESS * rough, MOST_CLOSE_CYCLES)
    made = [Candidate(trusted, 0.0, close)]
    if abs(mean) > rough / 2.0:  # an acceleration, and not the error of an uncorrected phase
        made.append(Candidate(trusted, mean, close))
    for candidate in made:
        candidate.wait(sum(place.elapsed for place in bad))
    return made


def _bends(places: Sequence[Place]) -> list[float]:
    """Accelerations between the places, cycles per interval squared, newest first."""
    steps = [_step(places, back) for back in range(1, len(places))]
    return [
        ((new - old) + (new_part - old_part)) / place.elapsed
        for (new, new_part), (old, old_part), place in zip(steps, steps[1:], reversed(places), strict=False)
    ]
