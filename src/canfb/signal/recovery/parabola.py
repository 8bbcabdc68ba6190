"""Where the next sample of a machine can be whose jerk is limited, and perhaps its acceleration.

The parabola through the last three samples misses the next one by the third divided difference,

    |x - x'| <= j e (e + e1) (e + e1 + e2) / 6 + d (1 + |w1| + |w2| + |w3|),

with e, e1, e2 the intervals from sample to sample, newest first, j the largest jerk, d the largest error
of a phase and w the weights of the three samples. At equal intervals that is j + 8 d, over one missed
sample 4 j + 18 d, over two 10 j + 32 d. A phase has one sample in each cycle. So the position is certain
where this window contains one of them, and not two.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from canfb.signal.limits import PHASE_ERROR_CYCLES
from canfb.signal.third_order import step_weights
from canfb.signal.tracker import RESIDUAL_LIMIT, Track, split

ROUGHNESS_CYCLES = 0.02  # of a third difference: noise, and what a correction leaves


@dataclass(frozen=True)
class MotionLimits:
    """What the machine can do.

    residual_limit  of third-order prediction, cycles
    start_limit     of eq. 9, cycles: for the first samples
    jerk            largest, cycles per interval cubed; None: all that ``residual_limit`` allows
    acceleration    largest, cycles per interval squared; None: any
    phase_error     largest error of a phase, cycles
    instant_error   largest error of a sample time, intervals; times the speed it is one of the phase
    widest_limit    2010:01, cycles: what ``instant_error`` adds stays within it
    """

    residual_limit: float
    start_limit: float
    jerk: float | None = None
    acceleration: float | None = None
    phase_error: float = PHASE_ERROR_CYCLES
    instant_error: float = 0.0
    widest_limit: float = RESIDUAL_LIMIT

    @property
    def largest_second_difference(self) -> float:
        """Of samples one interval apart: the acceleration, and the errors of three phases; inf: any."""
        return math.inf if self.acceleration is None else self.acceleration + 4.0 * self.phase_error

    def from_parabola(self, elapsed: float, last: float, before: float, speed: float = 0.0) -> float:
        """How far a sample is from the parabola at most, cycles; the intervals newest first."""
        scale, weights = _parabola_scales(elapsed, last, before)
        most = self.residual_limit * max(scale, weights / 8.0)
        uncertain = self.instant_error * abs(speed) * weights
        most += min(uncertain, max(0.0, self.widest_limit * max(scale, weights / 8.0) - most))
        if self.jerk is None:
            return most
        return min(most, self.jerk * scale + self.phase_error * weights + uncertain)

    def from_line(self, elapsed: float, last: float, *, known_only: bool, speed: float = 0.0) -> float:
        """How far a sample is from the line through the last two at most, cycles.

        ``known_only``: not limited unless the acceleration is known.
        """
        weights = 2.0 + 2.0 * elapsed / last
        scale = elapsed * (elapsed + last) / 2.0
        most = math.inf if known_only else self.start_limit * max(scale, weights / 4.0)
        if self.acceleration is None:
            return most
        error = self.phase_error + self.instant_error * abs(speed)
        return min(most, self.acceleration * scale + error * weights)


def _parabola_scales(elapsed: float, last: float, before: float) -> tuple[float, float]:
    """How often a jerk counts in the distance from the parabola, and an error of all phases; 1 and 8."""
    weight, weight_before = step_weights(elapsed, last, before)
    weights = 2.0 + 2.0 * (weight + weight_before)  # x - x1 (1 + w) + x2 (w + w') - x3 w'
    return elapsed * (elapsed + last) * (elapsed + last + before) / 6.0, weights


class Spot(NamedTuple):
    """A sample on a trajectory: cycle count, phase, and its time in intervals."""

    cycles: int
    phase: float
    time: float


class Parabola:
    """The last samples of a motion, at most three, and where it can go on.

    ``speed_cycles``: that of a machine of which a single sample is known, cycles per interval. ``rough``: the
    largest third difference since it began, cycles, beyond :data:`ROUGHNESS_CYCLES`.
    """

    __slots__ = ("rough", "speed_cycles", "spots")

    def __init__(self, spots: tuple[Spot, ...], speed_cycles: float = 0.0, rough: float = 0.0) -> None:
        self.spots = spots[-3:]
        self.speed_cycles = speed_cycles
        self.rough = rough

    def continuations(self, phase: float, time: float, limits: MotionLimits) -> range:
        """The cycle counts that a sample of this phase can have at this time."""
        last = self.spots[-1]
        low, high = self._window(time, limits)
        return range(last.cycles + math.floor(low - phase) + 1, last.cycles + math.ceil(high - phase))

    def roughness(self, cycles: int, phase: float, time: float, spare: float = 0.0) -> float:
        """The third difference with such a sample, of samples one interval apart; 0 with less than three.

        Errors of the phases may make up for ``spare`` of it.
        """
        if len(self.spots) < 3:
            return 0.0
        third, before, last = (spot.time for spot in self.spots)
        scale, weights = _parabola_scales(time - last, last - before, before - third)
        away = (cycles - self.spots[-1].cycles) + phase - self._ahead(time)
        return max(0.0, abs(away) - spare * weights / 8.0) / max(scale, weights / 8.0)

    def extended(self, cycles: int, phase: float, time: float) -> Parabola:
        """This trajectory with one more sample."""
        rough = max(self.rough, self.roughness(cycles, phase, time, ROUGHNESS_CYCLES))
        return Parabola((*self.spots, Spot(cycles, phase, time)), rough=rough)

    def predict(self, time: float) -> Track:
        """The position at this time with the last acceleration; never ok."""
        turns, phase = split(self._ahead(time))
        return Track(self.spots[-1].cycles + turns, phase, 0.5, False)

    def _window(self, time: float, limits: MotionLimits) -> tuple[float, float]:
        """Lowest and highest position, cycles, from the cycle count of the last sample on."""
        *_, last = self.spots
        elapsed = time - last.time
        if len(self.spots) == 1:
            middle, most = last.phase + self.speed_cycles * elapsed, limits.start_limit * elapsed
            return middle - most, middle + most
        interval = last.time - self.spots[-2].time
        moved = _moved(self.spots[-2], last)
        line = last.phase + moved * (elapsed / interval)
        most = limits.from_line(elapsed, interval, known_only=len(self.spots) == 3, speed=moved / interval)
        low, high = line - most, line + most
        if len(self.spots) == 3:
            middle = self._ahead(time)
            before = self.spots[-2].time - self.spots[-3].time
            most = limits.from_parabola(elapsed, interval, before, moved / interval)
            low, high = max(low, middle - most), min(high, middle + most)
        return low, high

    def _ahead(self, time: float) -> float:
        """Position at this time by the last samples, cycles, from the cycle count of the last one on."""
        *_, last = self.spots
        elapsed = time - last.time
        if len(self.spots) == 1:
            return last.phase + self.speed_cycles * elapsed
        middle = self.spots[-2]
        interval, moved = last.time - middle.time, _moved(middle, last)
        if len(self.spots) == 2:
            return last.phase + moved * (elapsed / interval)
        first = self.spots[-3]
        weight, weight_before = step_weights(elapsed, interval, middle.time - first.time)
        return last.phase + moved * weight - _moved(first, middle) * weight_before


def _moved(old: Spot, new: Spot) -> float:
    return (new.cycles - old.cycles) + (new.phase - old.phase)


def third_differences(spots: Sequence[Spot]) -> list[float]:
    """Their size along a motion, of samples one interval apart, oldest first, cycles."""
    return [Parabola(tuple(spots[k - 3 : k])).roughness(*spots[k]) for k in range(3, len(spots))]
