"""The time from a bad sample until the position is certain again, or lost, with third-order prediction.

Nothing is assumed of the acceleration. The jerk is within its limits, and

- samples that were missed or failed their own checks are known to be bad; all others are good, or
- a residual over its limit says that one sample is bad, this one or one of the three before it.

Each possibility is followed as a trajectory of its own. It ends where no cycle count of the next sample
is within the limits (:mod:`canfb.signal.recovery.parabola`): what it assumed is not so. The true possibility
is among those followed and never ends. So when all that are left agree on the last samples, these are right.

After a gap, a sample may have several cycle counts within the limits: each is followed. Two trajectories
that differ in the three samples after the gap differ by a parabola through whole cycles, which no later
sample tells apart: the position is lost. After a residual over the limit, it is lost with the first
sample that has more than one.

More samples may have been bad than assumed. Random phases pass by chance, each new one with a probability of
twice the residual limit. So unless samples were only missed, enough must follow for it to be below 1e-5, the
motion must be as smooth as before, and the same phase again and again decides nothing where it was another
one before.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from enum import Enum

from canfb.signal.recovery.bridge import Place
from canfb.signal.recovery.parabola import (
    ROUGHNESS_CYCLES,
    MotionLimits,
    Parabola,
    Spot,
    third_differences,
)
from canfb.signal.tracker import Track

# A glitch below the residual limit is seen up to three samples later: the residual has it four times.
DOUBTED_BEFORE = 3
DETERMINING = 3  # samples that position, speed and acceleration come from
CHANCE = 1e-5
# After a bad sample the third differences may be this many times the largest before it; and noise.
ROUGHNESS_FACTOR = 1.25
FEWEST_SEEN = 4
MOST_POSSIBLE = 64  # trajectories after a gap; far more than can ever be told apart
MOST_CHANCE = 0.9  # of one sample: as many confirm as ever do
LONGEST_TRIAL = 32  # intervals, beyond those that may be coasted


class TrialResult(Enum):
    """Of the samples so far."""

    OPEN = "more samples must confirm"
    DECIDED = "all possibilities that are left agree"
    LOST = "none is left, or no sample can decide between them"


class Trial:
    """All that the position can be since the last one that was certain.

    ``before``: the accepted places, oldest first, at least one. ``speed_cycles``: that of a machine of which
    there is only one, cycles per interval.
    """

    def __init__(self, before: Sequence[Place], limits: MotionLimits, speed_cycles: float = 0.0) -> None:
        self._before = _spots(before)
        self.limits = limits
        self._now = 0.0
        self._last_good = 0.0
        self._followed = 0  # samples since the last one that was bad or missed
        self._only_missed = True
        self._only_gaps = True  # no residual was over its limit
        self._is_lost = False
        self._possible = [_until(self._before, speed_cycles)]

    @property
    def places(self) -> list[Place]:
        """The last three samples, where :meth:`meet` has decided, with the intervals before each."""
        spots = self._possible[0].spots
        since = [spots[0].time - self._before[-1].time]
        since += [new.time - old.time for old, new in itertools.pairwise(spots)]
        return [Place(spot.cycles, spot.phase, e) for spot, e in zip(spots, since, strict=True)]

    @property
    def track(self) -> Track:
        """The position now, as far as it is known; never ok."""
        first = self._possible[0]
        last = first.spots[-1]
        if last.time == self._now:
            return Track(last.cycles, last.phase, 0.5, False)
        return first.predict(self._now)

    def rescale(self, factor: float) -> None:
        """Intervals are counted in another unit: all are ``factor`` times as many of it."""
        self._now *= factor
        self._last_good *= factor
        self._before = _rescaled(self._before, factor)
        self._possible = [
            Parabola(_rescaled(one.spots, factor), one.speed_cycles / factor, one.rough)
            for one in self._possible
        ]

    def contradicted(self, phase: float, elapsed: float) -> None:
        """It begins with a sample over the limit, ``elapsed`` intervals later: this or one before is bad."""
        self._now += elapsed
        self._only_missed = self._only_gaps = False
        if len(self._before) < DETERMINING + DOUBTED_BEFORE:
            self._is_lost = True  # too little is known
            return
        newest = Spot(0, phase, self._now)
        for count in range(1, DOUBTED_BEFORE + 1):
            good, later = self._before[:-count], self._before[len(self._before) - count + 1 :]
            here: Parabola | None = _until(good)
            for spot in (*later, newest):
                here = here and next(iter(self._extended(here, spot.phase, spot.time)), None)
            if here is not None:
                self._possible.append(here)

    def wait(self, elapsed: float, missed: bool) -> None:
        """A bad sample, or none (``missed``), after ``elapsed`` intervals."""
        self._now += elapsed
        self._followed = 0
        self._only_missed &= missed

    def meet(self, phase: float, elapsed: float) -> TrialResult:
        """A sample that passed its own checks, ``elapsed`` intervals after the one before."""
        self._now += elapsed
        self._followed += 1
        left = [longer for one in self._possible for longer in self._extended(one, phase, self._now)]
        if self._is_lost or not 0 < len(left) <= MOST_POSSIBLE:
            self._is_lost = True
            return TrialResult.LOST
        self._possible, self._last_good = left, self._now
        agreed = all(one.spots == left[0].spots for one in left)
        if self._only_gaps and not agreed and self._followed >= DETERMINING:
            self._is_lost = True
            return TrialResult.LOST
        if not agreed or self._followed < (DETERMINING if self._only_missed else self.enough):
            return TrialResult.OPEN
        if self._only_missed:
            return TrialResult.DECIDED
        if _repeats(left[0].spots, self._before[-DOUBTED_BEFORE - 1 :]):
            return TrialResult.OPEN
        if min(one.rough for one in left) <= self._most_rough():
            return TrialResult.DECIDED
        self._is_lost = True
        return TrialResult.LOST

    def _most_rough(self) -> float:
        """Of a motion that goes on as before. The last samples do not count: they may have been bad, by less
        than the limit, as long as a residual remembers."""
        seen = third_differences(self._before)[: -2 * DOUBTED_BEFORE]
        return ROUGHNESS_FACTOR * max(seen) if len(seen) >= FEWEST_SEEN else -1.0

    @property
    def enough(self) -> int:
        """Samples that must follow where one was bad: :data:`CHANCE` that random phases do."""
        chance = min(2.0 * self.limits.residual_limit, MOST_CHANCE)
        return DETERMINING + math.ceil(math.log(CHANCE) / math.log(chance))

    def is_over(self, coast_samples: int) -> bool:
        """True if it is lost: no sample to go on from for longer than that, or no decision for very long."""
        waited = self._now - self._last_good >= coast_samples + 0.5
        return self._is_lost or waited or self._now > coast_samples + LONGEST_TRIAL

    def _extended(self, one: Parabola, phase: float, time: float) -> list[Parabola]:
        """``one`` with this sample, at each place where it can be. Several are for a gap only."""
        cycles = one.continuations(phase, time, self.limits)
        if len(cycles) > (MOST_POSSIBLE if self._only_gaps else 1):
            self._is_lost = True
            return []
        return [one.extended(count, phase, time) for count in cycles]


def _repeats(spots: Sequence[Spot], before: Sequence[Spot]) -> bool:
    """The same phase again and again, and others ``before``: a converter may be dead since the fault."""
    stood = len({(spot.cycles, spot.phase) for spot in (*before, *spots)}) == 1
    return len({spot.phase for spot in spots}) == 1 and not stood


def _until(good: tuple[Spot, ...], speed_cycles: float = 0.0) -> Parabola:
    """The trajectory that ends with these samples; the last ones of them are to be smooth, too."""
    rough = max(third_differences(good)[-DOUBTED_BEFORE:], default=0.0) - ROUGHNESS_CYCLES
    return Parabola(good, speed_cycles, max(0.0, rough))


def _spots(places: Sequence[Place]) -> tuple[Spot, ...]:
    """Times count up to the last one, at 0."""
    spots, time = [], 0.0
    for place in reversed(places):
        spots.append(Spot(place.cycles, place.phase, time))
        time -= place.elapsed
    return tuple(reversed(spots))


def _rescaled(spots: Sequence[Spot], factor: float) -> tuple[Spot, ...]:
    return tuple(spot._replace(time=spot.time * factor) for spot in spots)
