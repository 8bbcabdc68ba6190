"""A witness: an absolute sensor with a tolerance, which is compared with the counted position.

One value proves nothing. Three values in a row beyond the tolerance contradict the position. The missing
speed is found by :class:`SpeedSearch`; the missing count if only one is within the tolerance, eight times in
a row.

**Speed**: eq. 9 may count wrong by s whole cycles per interval. The true position is y + c + s t, with y as
counted, and whole c and s. The sensor shows the true displacement, with an error. Each pair of its values
limits s,

    |ahead_j - ahead_i - s (t_j - t_i)| <= error_ij,

where ``ahead`` is its displacement minus the counted one. One value may be false by any d. With E the error
of a pair, its neighbour gives s >= d - E, and a value t intervals away s <= (d + E) / t: these exclude each
other once t >= 2 E + 1. So the values that agree must span that time.

The coarse track, one cycle per revolution (paper, section 4), has a value at every sample.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from canfb.signal.second_position import SecondSensor

MOST_VALUES = 512  # remembered; of more, every second is forgotten: the search then takes longer
LEAST_VALUES = 3
PHASE_CYCLES = 0.05  # error of the counted displacement: noise and an uncorrected phase at both ends


class SpeedSearch:
    """Finds the whole cycles per interval that the counted speed lacks.

    The error of the displacement between two values is at most ``slope`` times that displacement, or
    ``most_cycles`` if less, plus ``noise_cycles``.
    """

    def __init__(self, slope: float, most_cycles: float, noise_cycles: float) -> None:
        self._slope, self._most_cycles = slope, most_cycles
        self._noise_cycles = noise_cycles + PHASE_CYCLES
        self._values = np.empty((3, MOST_VALUES))  # time, ahead, moved
        self.restart()

    def restart(self) -> None:
        """Begin at the next value. Eq. 9 must count without a gap from there on."""
        self._known = 0
        self._error = 0.0  # largest error of a pair, cycles
        self._low, self._high = -math.inf, math.inf

    def feed(self, time: float, ahead_cycles: float, moved_cycles: float) -> int | None:
        """Take a value; return the missing cycles per interval, None while they are not certain.

        ``time`` in intervals; ``moved_cycles``: displacement by the sensor, from any origin;
        ``ahead_cycles``: that minus the counted one.
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


DISAGREEING = 3  # values in a row that contradict: a single one may be a fault of the bus
HYSTERESIS = 0.75  # a disagreement ends below this part of the tolerance
PROVISIONAL = 2.0  # factor on the tolerance while the offset is one that was learned in motion
AGREEING = 8  # values in a row that must give the same shift of the count


class Pair(NamedTuple):
    """Position and value of the sensor at one instant.

    cycles, phase   the counted position
    value           of the sensor, unwrapped: increments, or revolutions
    time            sampling intervals since the start
    """

    cycles: int
    phase: float
    value: float | int
    time: float


class Witness:
    """``origin`` is a pair at which both showed one place, None: not known; ``firm``: not provisional.

    ``scale`` converts displacements of the sensor to cycles, and has

    tolerance_cycles  largest difference from the position
    step_cycles       resolution of the value, added to the tolerance
    slope             change of its error per displacement, up to twice the tolerance
    noise_cycles      noise of a value
    steady_cycles     largest difference of values that agree on a count; a drift exceeds it
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
        """The witness has confirmed the speed since the start."""
        self.disagreeing = 0
        """Number of values in a row that contradict the position."""
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
        """Sensor minus position; 0.0 while that is not known."""
        if self.origin is None:
            return 0.0
        away, period = self.scale.difference_cycles(self.origin, pair), self.scale.period_cycles
        return away if math.isinf(period) else away - period * math.floor(away / period + 0.5)

    def fits(self, pair: Pair) -> bool:
        """True if the value is within the tolerance, or within 3/4 of it after one that was not."""
        return abs(self.away_cycles(pair)) <= self.limit_cycles * (HYSTERESIS if self.disagreeing else 1.0)

    def missing_speed(self, pair: Pair) -> int | None:
        """The cycles per interval that the counted speed lacks; None: not certain."""
        self._first = first = self._first or pair
        scale = self.scale
        return self._search.feed(
            pair.time, scale.difference_cycles(first, pair), scale.moved_cycles(first, pair)
        )

    def missing_count(self, pair: Pair) -> tuple[int, bool]:
        """The cycles that the count lacks, if certain (True); else cycles that bring it near the sensor."""
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
    """Whole cycles whose difference from ``away_cycles`` is within the limit."""
    return range(math.ceil(away_cycles - limit_cycles), math.floor(away_cycles + limit_cycles) + 1)


LOWEST_AMPLITUDE = 0.1  # of the full scale; a coarse track below it is ignored
NOISE_LSB = 4.0  # noise of the angle, in counts of its tracks
HARMONIC = 2  # highest harmonic per revolution in the error of the coarse track


class CoarseScale:
    """Revolutions in cycles; the error of the coarse track is at most ``limit_revolutions`` (2010:05)."""

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


STEADY_CYCLES = 0.1  # largest difference of values that agree on a count, beside the resolution


class SecondScale:
    """Displacements of the other sensor in cycles.

    An increment is a fraction of cycles: displacements are integers over its denominator, and only the
    result is rounded.
    """

    slope = 1.0  # the other sensor is on the drive, and may move alone by backlash
    period_cycles = math.inf

    def __init__(self, sensor: SecondSensor, cycles_per_revolution: int) -> None:
        cycles = Fraction(cycles_per_revolution * sensor.revolutions, sensor.increments)
        self._cycles = -cycles.numerator if sensor.reversed else cycles.numerator
        self._per = cycles.denominator
        self.step_cycles = self.noise_cycles = float(cycles)
        """One increment in cycles: the resolution."""
        self.steady_cycles = STEADY_CYCLES + 2.0 * self.step_cycles
        self.tolerance_cycles = sensor.tolerance_revolutions * cycles_per_revolution

    def difference_cycles(self, since: Pair, now: Pair) -> float:
        """Displacement of the other sensor minus that of the encoder."""
        return self.moved_cycles(since, now, now.cycles - since.cycles) - (now.phase - since.phase)

    def moved_cycles(self, since: Pair, now: Pair, less_cycles: int = 0) -> float:
        """Displacement of the other sensor, cycles, minus ``less_cycles``: the nearest float."""
        moved = (int(now.value) - int(since.value)) * self._cycles
        return (moved - less_cycles * self._per) / self._per


class CoarseTrack(Witness):
    """The coarse track of an encoder; its error is at most ``limit_revolutions``."""

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
