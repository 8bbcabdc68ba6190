"""The time from a bad sample until the position is certain again, or lost.

Where samples were missing and nothing else was wrong, all that came are good: the one trajectory
through them is the position (:mod:`canfb.signal.recovery.gap`).

Else the samples that come form runs: neighbouring ones whose accelerations agree. A run that is
long enough not to be chance is joined to the places before the fault, if only one
trajectory does that (:mod:`canfb.signal.recovery.bridge`), and if good samples all around the bad ones
would not lead elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

from canfb.signal.recovery.bridge import (
    LAST_PLACES,
    Passage,
    Place,
    accelerations,
    bridge,
    roughness,
    run_accelerations,
    speed,
)
from canfb.signal.recovery.gap import Unseen, alike, fitting, passed, within
from canfb.signal.tracker import Track, split

# Two accelerations that agree: with fewer there is nothing to compare, and one sample too many may be chance.
SHORTEST_RUN = 4
# Where a known acceleration leaves more than one trajectory, the likeness to what was seen decides over a
# gap of this many intervals, one missed sample: it takes a push of a third of a cycle per interval squared
# that begins and ends within the gap to pass for another one. Longer gaps need less.
SURE_INTERVALS = 2
# A machine whose largest acceleration is not known uses this part of the residual limit; errors of the phase
# have the rest.
USED_PART = 0.85
LONGEST_RUN = 12  # one that is not joined by then never will be
LONGEST_DOUBT = 32  # intervals without a decision, beyond those that may be coasted
# The widths were chosen with the fault campaign (docs/fault-campaign.md): noise, an uncorrected encoder
# (0.05 cycle in a second difference) and vibration stay within them.
RUN_WIDTH = 0.25  # of the accelerations in a run, cycles per interval squared, at most
ROUGHNESS_FACTOR = 2.5  # and at most this many times their roughness before the fault, and some more
RUN_WIDTH_CYCLES = 0.01
# Samples with any phase agree by chance with this probability; the first two of a run always do.
CHANCE = 1e-5
# How close to the prediction a sample is counted from it, cycles, one interval after the last: the error of
# an uncorrected encoder in eq. 9 (PHASE_ERROR_MARGIN_CYCLES), and some noise.
CLOSE_CYCLES = 0.055


class Undecided(Enum):
    """Why the samples after a gap do not say where the position is."""

    YET = "more samples may decide"
    FOR_EVER = "no more samples can decide"


class _Sample(NamedTuple):
    time: float  # intervals since the last accepted place
    phase: float


class Doubt:
    """What is known since the last accepted sample.

    ``before``: the accepted places, oldest first, at least one, of which the last ``doubted``
    may have been bad, and as many samples after them without a sign of it. ``limit``: the
    residual limit, cycles.
    """

    def __init__(self, before: Sequence[Place], doubted: int, limit: float) -> None:
        self._before = before
        self._doubted = doubted
        self._limit = limit
        self._now = 0.0
        self._last_good = 0.0  # the time of the last sample that nothing contradicts
        self._contradicted = True  # or there would be no doubt
        self._left_out = 0  # samples that were contradicted
        self._run: list[_Sample] = []
        self._most_width = ROUGHNESS_FACTOR * roughness(accelerations(before)) + RUN_WIDTH_CYCLES
        self._anchor, self._speed = before[-1], speed(before)
        self._anchored = 0.0
        self._since_gap: list[_Sample] = []  # all samples since the last bad or missed one
        self._only_missed = False
        self._from_gap = False  # it began with a sample that failed its checks, or with none

    @property
    def only_missed(self) -> bool:
        """Samples were missing, and nothing else was wrong."""
        return self._only_missed

    def is_over(self, coast_samples: int) -> bool:
        """True if there was no good sample for longer than that, or no decision for very long."""
        alone = len(self._run) == 1 and self._contradicted
        gap = self._now if alone or not self._run else self._run[0].time - 1.0
        return gap - self._last_good >= coast_samples + 0.5 or self._now > coast_samples + LONGEST_DOUBT

    def wait(self, elapsed: float, missed: bool = False) -> Track:
        """A bad sample, or none (``missed``), after ``elapsed`` intervals: the predicted position."""
        if self._now == 0.0:
            self._from_gap = self._only_missed = True
        self._only_missed &= missed
        self._now += elapsed
        self._contradicted = False
        self._run, self._since_gap = [], []
        cycles, part = self._predict()
        turns, phase = split(part)
        return Track(cycles + turns, phase, 0.5, False)

    def meet(self, phase: float, elapsed: float) -> Track | None:
        """A sample ``elapsed`` intervals after the one before: where it is if it is near the prediction."""
        self._now += elapsed
        self._run.append(_Sample(self._now, phase))
        self._since_gap.append(self._run[-1])
        if not self._run_agrees():
            self._contradicted = True
            self._left_out += len(self._run) - 2
            del self._run[:-2]
        if not self._contradicted or len(self._run) >= SHORTEST_RUN:
            self._last_good = self._now
        cycles, part = self._predict()
        c = part - phase
        turns = round(c)
        residual = abs(turns - c)
        gap = self._now - self._anchored
        if residual > CLOSE_CYCLES * (gap + 1.0) / 2.0:
            return None
        place = Place(cycles + turns, phase, gap)
        if gap < 1.5:
            self._speed = speed([self._anchor, place])
        self._anchor, self._anchored = place, self._now
        return Track(place.cycles, phase, residual, True)

    def settle(self, known: float | None) -> list[Place] | Undecided:
        """The places after the gap if samples were missing and nothing else was wrong.

        ``known``: the largest acceleration of the machine, cycles per interval squared; None: not
        known. A single place is the first one after the gap; the speed is not certain yet then.
        """
        run = self._since_gap
        even = self._even(run)
        if max(map(abs, run_accelerations(even)), default=0.0) >= self._limit:
            self._only_missed = False  # something else is wrong
            return Undecided.YET
        start, unseen = self._unseen(even, run)
        most = self._limit if known is None else min(known, self._limit)
        if len(run) == 1:
            cycles = passed(unseen, most)
            if len(cycles) != 1:
                return Undecided.YET
            return [Place(start + cycles[0], run[0].phase, run[0].time)]
        found = fitting(unseen, within(most, unseen.intervals))
        if not found:
            self._only_missed = False  # no machine within the limits can do that
            return Undecided.YET
        if len(found) > 1:
            if known is not None and unseen.intervals > SURE_INTERVALS:
                return Undecided.FOR_EVER
            if len(run) < SHORTEST_RUN:
                return Undecided.YET
            if known is None:
                found = fitting(unseen, within(USED_PART * most, unseen.intervals))
            if len(found) != 1:
                found = self._alike(even, unseen, most, known is not None)
        if not found:
            return Undecided.FOR_EVER
        cycles_passed, step = found[0]
        places = self._places(run, even, Passage(start + cycles_passed, step, 0.0))
        return [places[0]._replace(elapsed=run[0].time), *places[1:]]

    def _unseen(self, even: Sequence[float], run: Sequence[_Sample]) -> tuple[int, Unseen]:
        """The gap between the last place and a run after it, and from where its displacement counts."""
        last, old, since = self._before[-1], speed(self._before), run[0].time
        intervals = max(1, round(since))
        uneven = abs(last.elapsed - 1.0)
        if len(run) > 1:
            uneven += abs(run[1].time - since - 1.0)
        start = math.floor(last.cycles + old * since)
        displacement = (start - last.cycles) + (even[0] - last.phase) - old * since
        change = even[1] - even[0] - old if len(even) > 1 else math.nan
        return start, Unseen(intervals, displacement, change, uneven, since - intervals)

    def _alike(
        self, even: Sequence[float], unseen: Unseen, limit: float, known: bool
    ) -> list[tuple[int, int]]:
        """The one trajectory through the gap that is like what was seen around it; empty if it is unclear."""
        # The longer the gap, the less it takes to pass for another motion: then only the last ones count.
        near = self._before if unseen.intervals <= SURE_INTERVALS else self._before[-LAST_PLACES:]
        before, after = accelerations(near) or [0.0], run_accelerations(even)
        found = alike(unseen, before, after, limit, known)
        return [] if found is None else [found]

    def decide(self, coast_samples: int) -> list[Place] | Undecided:
        """The places after the gap.

        Up to ``coast_samples`` and ``doubted`` intervals are bridged, bad samples or none.
        """
        if len(self._run) < SHORTEST_RUN:
            return Undecided.YET
        even = self._even(self._run)
        length = self._smooth(even)
        run, even = self._run[-length:], even[-length:]
        if length < SHORTEST_RUN or length < _enough(_width(run_accelerations(even))):
            return Undecided.FOR_EVER if len(self._run) >= LONGEST_RUN else Undecided.YET
        left_out = self._left_out + len(self._run) - length
        if left_out > self._doubted or run[0].time - 1.0 > coast_samples + self._doubted:
            return Undecided.FOR_EVER  # more than a glitch: what comes then is not to be trusted either
        passage = bridge(self._before, even, run[0].time, self._doubted, self._limit)
        if passage is None or self._leads_elsewhere(run, even, passage):
            return Undecided.FOR_EVER
        return self._places(run, even, passage) if length >= _enough(passage.width) else Undecided.YET

    def _leads_elsewhere(self, run: Sequence[_Sample], even: Sequence[float], passage: Passage) -> bool:
        """True if good samples all around the bad ones would lead to another position."""
        if not self._from_gap or len(run) != len(self._since_gap):
            return False
        start, unseen = self._unseen(even, run)
        found = self._alike(even, unseen, self._limit, False)
        return bool(found) and (start + found[0][0], found[0][1]) != passage[:2]

    def _smooth(self, even: Sequence[float]) -> int:
        """How many of the last samples run as smoothly as those before the fault did.

        All of them must be taken: to leave some out would be to choose among trajectories.
        """
        seen = run_accelerations(even)[::-1]
        for length in range(2, len(seen) + 1):
            if _width(seen[:length]) > self._most_width:
                return length + 1
        return len(even)

    def _run_agrees(self) -> bool:
        if len(self._run) < 3:
            return True
        seen = run_accelerations(self._even(self._run))
        return max(map(abs, seen)) < self._limit and _width(seen) <= RUN_WIDTH

    def _even(self, run: Sequence[_Sample]) -> list[float]:
        """Phases as they would be one interval apart; the speed is known well enough for that."""
        start = run[0].time
        return [sample.phase - self._speed * (sample.time - start - k) for k, sample in enumerate(run)]

    def _predict(self) -> tuple[int, float]:
        displacement = self._speed * (self._now - self._anchored)
        whole = math.floor(displacement)
        return self._anchor.cycles + whole, self._anchor.phase + (displacement - whole)

    def _places(self, run: Sequence[_Sample], even: Sequence[float], passage: Passage) -> list[Place]:
        """The places of a run that continues this trajectory."""
        at = [even[0], even[1] + passage.step_cycles]
        for bend in run_accelerations(even):
            at.append(2.0 * at[-1] - at[-2] + bend)
        places = []
        time = run[0].time - 1.0
        for sample, position, offset in zip(run, at, even, strict=True):
            cycles = passage.cycles + round(position - offset)
            places.append(Place(cycles, sample.phase, sample.time - time))
            time = sample.time
        return places


def _width(seen: Sequence[float]) -> float:
    return max(seen) - min(seen) if seen else 0.0


def _enough(width: float) -> int:
    """Samples in a run for it not to be chance, if their accelerations spread over this width."""
    return max(SHORTEST_RUN, 2 + math.ceil(math.log(CHANCE) / math.log(min(max(width, 1e-9), RUN_WIDTH * 2))))
