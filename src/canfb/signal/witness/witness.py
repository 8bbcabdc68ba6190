"""A sensor that knows the position without counting, held against the counted one.

It has a value and a tolerance, and is believed k times in a row. What it may take away: three values
beyond the tolerance contradict the position. What it may give: the speed that the count lacks
(:class:`SpeedSearch`), and the count, where just one is within the tolerance, eight times.

**Speed**: by how many whole cycles per interval eq. 9 counts wrongly. The truth is y + c + s t with y as
eq. 9 counts it, and whole numbers c and s. An absolute sensor shows how far the machine has really moved,
with an error. Each pair of its values cuts the range of s,

    |ahead_j - ahead_i - s (t_j - t_i)| <= error_ij,

where ``ahead`` is its displacement less the counted one. One value may be false, by any d: beyond the
error E of a pair a neighbour gives s >= d - E, and a value t intervals away s <= (d + E) / t, so that
nothing is left once t >= 2 E + 1. The values that agree must span that long.

The coarse track, one cycle per revolution (paper, section 4), is one with a value at every sample.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from canfb.signal.second_position import SecondSensor

MOST_VALUES = 512  # remembered; when there are more, every second one is forgotten, which only costs time
LEAST_VALUES = 3
PHASE_CYCLES = 0.05  # of the counted displacement: noise and an uncorrected phase at both ends


class SpeedSearch:
    """Finds the whole cycles per interval that the counted speed lacks.

    Two values differ from the truth by at most ``most_cycles``, or ``slope`` times the way between them,
    and ``noise_cycles``.
    """

    def __init__(self, slope: float, most_cycles: float, noise_cycles: float) -> None:
        self._slope, self._most_cycles = slope, most_cycles
        self._noise_cycles = noise_cycles + PHASE_CYCLES
        self._values = np.empty((3, MOST_VALUES))  # time, ahead, moved
        self.restart()

    def restart(self) -> None:
        """The next value is the first. Eq. 9 must count without a gap from there on."""
        self._known = 0
        self._error = 0.0  # the largest of a pair, cycles
        self._low, self._high = -math.inf, math.inf

    def feed(self, time: float, ahead_cycles: float, moved_cycles: float) -> int | None:
        """The number, None as long as it is not certain. ``time`` in intervals; ``moved_cycles`` by the
        sensor since any instant, ``ahead_cycles`` that less the counted one.
        """
        known = self._known
        if known and time > self._values[0, known - 1]:
            times, ahead, moved = self._values[:, :known]
            apart = time - times
            error = (
                np.minimum(self._slope * np.abs(moved_cycles - moved), self._most_cycles) + self._noise_cycles
            )
            self._error = max(self._error, float(error.max()))
            self._low = max(self._low, float(((ahead_cycles - ahead - error) / apart).max()))
            self._high = min(self._high, float(((ahead_cycles - ahead + error) / apart).min()))
        self._remember(time, ahead_cycles, moved_cycles)
        if self._known < LEAST_VALUES or not math.isfinite(self._high - self._low):
            return None
        least, most = math.ceil(self._low), math.floor(self._high)
        if least > most:
            self.restart()
            self._remember(time, ahead_cycles, moved_cycles)
        spans = time - self._values[0, 0] >= 2.0 * self._error + 1.0
        return least if least == most and spans else None

    def _remember(self, time: float, ahead_cycles: float, moved_cycles: float) -> None:
        if self._known == MOST_VALUES:
            self._values[:, : MOST_VALUES // 2] = self._values[:, ::2]
            self._known = MOST_VALUES // 2
        self._values[:, self._known] = time, ahead_cycles, moved_cycles
        self._known += 1


DISAGREEING = 3  # values in a row: a single one may be a fault of the bus
HYSTERESIS = 0.75  # a disagreement ends below this part of the tolerance
PROVISIONAL = 2.0  # times the tolerance, for an offset that was learned in motion
AGREEING = 8  # values in a row with the same shift of the count


class Pair(NamedTuple):
    """What both say of one instant.

    cycles, phase   the counted position
    value           of the sensor, unwrapped: increments, or revolutions
    time            sampling intervals since the start
    """

    cycles: int
    phase: float
    value: float | int
    time: float


class Witness:
    """``origin`` is a pair at which both stood for the same place, None: not known; ``firm``: for good.

    Its ``scale`` has distances of the sensor in cycles: how far it has moved, and how much further than the
    count, and

    tolerance_cycles  how far it may be from the position
    step_cycles       of its value: so far it may be further off
    slope             its error changes by so much of a way, until it is twice the tolerance
    noise_cycles      of a value
    steady_cycles     values that agree on a count differ by no more: if they drift, one does not follow
    period_cycles     period of its value
    """

    def __init__(self, scale: CoarseScale | SecondScale) -> None:
        self.use(scale)
        self.restart(keep=False)

    def use(self, scale: CoarseScale | SecondScale) -> None:
        self.scale = scale
        self._search = SpeedSearch(scale.slope, 2.0 * scale.tolerance_cycles, scale.noise_cycles)
        self.restart_search()

    def restart(self, keep: bool) -> None:
        if not keep:
            self.forget()
        self.proven = False
        """It has shown the speed since the start."""
        self.disagreeing = 0
        """Values in a row that contradict the position."""
        self.restart_search()

    def forget(self) -> None:
        self.origin: Pair | None = None
        self.firm = False
        self.disagreeing = 0

    def restart_search(self) -> None:
        self._search.restart()
        self._first: Pair | None = None
        self._agreeing, self._shift, self._away = 0, 0, 0.0

    @property
    def disagrees(self) -> bool:
        return self.disagreeing >= DISAGREEING

    @property
    def limit_cycles(self) -> float:
        scale = self.scale
        return scale.tolerance_cycles * (1.0 if self.firm else PROVISIONAL) + scale.step_cycles

    def away_cycles(self, pair: Pair) -> float:
        """How much further the sensor stands than the position; 0.0 while that is not known."""
        if self.origin is None:
            return 0.0
        away, period = self.scale.difference_cycles(self.origin, pair), self.scale.period_cycles
        return away if math.isinf(period) else away - period * math.floor(away / period + 0.5)

    def fits(self, pair: Pair) -> bool:
        """The value is within the tolerance, or within 3/4 of it after one that was not."""
        return abs(self.away_cycles(pair)) <= self.limit_cycles * (HYSTERESIS if self.disagreeing else 1.0)

    def missing_speed(self, pair: Pair) -> int | None:
        """What the counted speed lacks, cycles per interval; None: not certain."""
        self._first = first = self._first or pair
        scale = self.scale
        return self._search.feed(
            pair.time, scale.difference_cycles(first, pair), scale.moved_cycles(first, pair)
        )

    def missing_count(self, pair: Pair) -> tuple[int, bool]:
        """What the count lacks, cycles, and whether that is certain; else it is a count near the sensor."""
        away, limit = self.away_cycles(pair), self.limit_cycles
        counts = counts_within(away, limit + PHASE_CYCLES)
        if len(counts) != 1:
            self._agreeing = 0
            return (0 if abs(away) <= limit else round(away)), False
        shift = counts[0]
        if not self._agreeing or shift != self._shift or abs(away - self._away) > self.scale.steady_cycles:
            self._agreeing, self._shift, self._away = 0, shift, away
        self._agreeing += 1
        return (shift, True) if self._agreeing >= AGREEING else (0, False)


def counts_within(away_cycles: float, limit_cycles: float) -> range:
    """Whole cycles that bring the rest within the limit."""
    return range(math.ceil(away_cycles - limit_cycles), math.floor(away_cycles + limit_cycles) + 1)


LOWEST_AMPLITUDE = 0.1  # of the full scale: a coarse track below it is ignored
NOISE_LSB = 4.0  # of the angle
HARMONIC = 2  # of the revolution, the highest that the error of the coarse track may have


class CoarseScale:
    """Revolutions in cycles; the coarse track itself must be right within ``limit_revolutions`` (2010:05)."""

    step_cycles = 0.0
    steady_cycles = math.inf  # its error changes along the revolution

    def __init__(self, cycles_per_revolution: int, full_scale_counts: int, limit_revolutions: float) -> None:
        self.given = cycles_per_revolution, full_scale_counts, limit_revolutions
        self.period_cycles = float(cycles_per_revolution)
        self.tolerance_cycles = limit_revolutions * cycles_per_revolution
        self.slope = 2.0 * math.pi * HARMONIC * limit_revolutions
        self.noise_cycles = NOISE_LSB / (math.pi * full_scale_counts) * cycles_per_revolution

    def moved_cycles(self, since: Pair, now: Pair) -> float:
        return (now.value - since.value) * self.period_cycles

    def difference_cycles(self, since: Pair, now: Pair) -> float:
        return self.moved_cycles(since, now) - (now.cycles - since.cycles) - (now.phase - since.phase)


STEADY_CYCLES = 0.1  # values that agree on a count differ by no more


class SecondScale:
    """Distances of the two sensors in cycles.

    An increment is N d / n cycles: distances are counted in 1/n cycle, and only the last result is rounded.
    """

    slope = 1.0  # the other sensor drives the machine
    period_cycles = math.inf

    def __init__(self, sensor: SecondSensor, cycles_per_revolution: int) -> None:
        cycles = Fraction(cycles_per_revolution * sensor.revolutions, sensor.increments)
        self._cycles = -cycles.numerator if sensor.reversed else cycles.numerator
        self._per = cycles.denominator
        self.step_cycles = self.noise_cycles = float(cycles)
        """One increment in cycles: how far the truth may be from a value."""
        self.steady_cycles = STEADY_CYCLES + 2.0 * self.step_cycles
        self.tolerance_cycles = sensor.tolerance_revolutions * cycles_per_revolution

    def difference_cycles(self, since: Pair, now: Pair) -> float:
        """How much further the other sensor has moved than the encoder."""
        return self.moved_cycles(since, now, now.cycles - since.cycles) - (now.phase - since.phase)

    def moved_cycles(self, since: Pair, now: Pair, less_cycles: int = 0) -> float:
        """How far the other sensor has moved, cycles, less ``less_cycles``: the nearest float."""
        moved = (int(now.value) - int(since.value)) * self._cycles
        return (moved - less_cycles * self._per) / self._per


class CoarseTrack(Witness):
    """Of ``cycles_per_revolution``, that may differ by ``limit_revolutions``."""

    scale: CoarseScale

    def __init__(self, cycles_per_revolution: int, full_scale_counts: int, limit_revolutions: float) -> None:
        self._turns = self._angle = 0.0  # whole revolutions, and the part of one at the last value
        super().__init__(CoarseScale(cycles_per_revolution, full_scale_counts, limit_revolutions))

    def limit(self, full_scale_counts: int, limit_revolutions: float) -> None:
        scale = CoarseScale(self.scale.given[0], full_scale_counts, limit_revolutions)
        if scale.given != self.scale.given:
            self.use(scale)

    def forget(self) -> None:
        super().forget()
        self.firm = True

    def angle(self, sine: float, cosine: float) -> float | None:
        """Angle, 0..1 revolution; None if its amplitude is too small."""
        lowest = LOWEST_AMPLITUDE * self.scale.given[1]
        if not sine * sine + cosine * cosine > lowest * lowest:
            return None
        return math.atan2(sine, cosine) / (2.0 * math.pi) % 1.0 % 1.0

    def pair(self, angle: float | None, cycles: int, phase: float, time: float) -> Pair | None:
        if angle is None:
            return None
        self._turns += math.floor(self._angle - angle + 0.5)
        self._angle = angle
        return Pair(cycles, phase, self._turns + angle, time)
