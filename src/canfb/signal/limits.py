"""Limits of acceleration and speed that eq. 9 allows (paper, eq. 10 and 12), and the bounds that the user
declares of machine, encoder and bus.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

from canfb.checks import LARGEST
from canfb.signal.bounded_motion import ORDER, BoundedMotion
from canfb.signal.tracker import RESIDUAL_LIMIT, check_residual_limit

RPM = 60.0 / (2.0 * math.pi)  # rpm per rad/s


def max_acceleration(
    cycles_per_revolution: float, sample_rate_hz: float, residual_limit: float = 0.5
) -> float:
    """Largest acceleration in rad/s^2 that eq. 9 follows: 2 pi/N fs^2 (eq. 10) times ``residual_limit``
    (cycles, 0 < limit <= 0.5).

    ``cycles_per_revolution`` and ``sample_rate_hz`` are positive. ValueError otherwise.
    """
    _check_positive(cycles_per_revolution=cycles_per_revolution, sample_rate_hz=sample_rate_hz)
    limit = check_residual_limit(residual_limit)
    return 2.0 * math.pi / cycles_per_revolution * limit * sample_rate_hz * sample_rate_hz


def max_speed(cycles_per_revolution: float, jitter_s: float, residual_limit: float = 1.0 / 3.0) -> float:
    """Largest speed in rad/s that eq. 9 follows without sample times if SYNC jitters by ``jitter_s``.

    The second difference of eq. 9 multiplies an error v j by up to four: 4 v j < ``residual_limit``
    (cycles, 0 < limit <= 0.5; minus the acceleration). ``cycles_per_revolution`` and
    ``jitter_s`` are positive. ValueError otherwise.
    """
    _check_positive(cycles_per_revolution=cycles_per_revolution, jitter_s=jitter_s)
    return 2.0 * math.pi / cycles_per_revolution * check_residual_limit(residual_limit) / (4.0 * jitter_s)


def _check_positive(**values: float) -> None:
    for name, value in values.items():
        if not 0.0 < value <= LARGEST:
            raise ValueError(f"{name} must be positive, not {value!r}")


# The default of 2010:0C is the error of the raw phase without a table, so it holds before the reference
# measurement, too. Eq. 9 weighs three phases by 1, 2, 1: a narrowed limit has a margin of four times this.
PHASE_ERROR_CYCLES = 0.0125
MOST_PHASE_ERROR_CYCLES = 0.0625  # of 2010:0C: 1/16 cycle; no encoder is worse
# The least value written after a measurement: with temperature and age, half of what a table removed returns.
CALIBRATED_PHASE_ERROR_CYCLES = 0.005


def narrowed_residual_limit(
    residual_limit: float,
    max_acceleration_rad_s2: float,
    cycles_per_revolution: float,
    interval_s: float,
    margin_cycles: float = math.inf,
    phase_error_cycles: float = PHASE_ERROR_CYCLES,
) -> float:
    """Residual limit in cycles if the largest acceleration a of the machine is known (2010:02):
    a N/(2 pi) T^2 plus the smaller of ``margin_cycles`` and four phase errors (2010:0C), at most
    ``residual_limit``.

    ``max_acceleration_rad_s2`` 0: not known. ``interval_s`` is the sampling interval T.
    """
    if max_acceleration_rad_s2 <= 0.0:
        return residual_limit
    expected = cycles_per_interval_squared(max_acceleration_rad_s2, cycles_per_revolution, interval_s)
    return min(residual_limit, expected + min(margin_cycles, 4.0 * phase_error_cycles))


def cycles_per_interval_squared(
    acceleration_rad_s2: float, cycles_per_revolution: float, interval_s: float
) -> float:
    return acceleration_rad_s2 * cycles_per_revolution / (2.0 * math.pi) * interval_s**2


MOST_IN_A_ROW = 255
SHARP = 1.0 / 6.0  # cycles: above it, one missed sample may lose the position (docs/supervision.md)
ROUNDING = 1e-9


def samples_without_harm(cycles: float) -> int:
    """The largest number of bad samples in a row, 0..255, that cannot falsify the count unnoticed.

    ``cycles`` is L + a, residual limit plus acceleration in cycles per interval squared
    (docs/supervision.md): as for missed samples between motions with exact phases.
    """
    return kept_samples(cycles, 0.0, 0.0)


def kept_samples(
    accepted_cycles: float,
    motion_cycles: float,
    phase_error_cycles: float,
    most: int = MOST_IN_A_ROW,
) -> int:
    """Missed or flagged samples in a row, 0..``most``, after which only one motion is left, for any phases.

    ``accepted_cycles`` is the largest acceleration that the estimator follows, ``motion_cycles`` that of
    the machine, cycles per interval^2 (docs/supervision.md).
    """
    total = accepted_cycles + motion_cycles
    count = 0
    while count < most and _between_motions(count + 1, total, phase_error_cycles) <= 1.0 + ROUNDING:
        count += 1
    return count


def _between_motions(missed: int, total_cycles: float, phase_error_cycles: float) -> float:
    changes = missed + 2
    return max(changes, changes * changes // 4) * total_cycles + 4.0 * phase_error_cycles * changes


DOUBT_ACCELERATION = (
    0.1  # default of 2010:0B, cycles per interval^2: up to it, one to three missed samples leave one motion
)
COAST_SAMPLES = 3  # default of 2010:03
MOST_BAD_SAMPLES = 8  # largest 2010:0A, for which the estimator remembers enough samples
MOST_BY_DEFAULT = 3  # each one more multiplies the computing time of a contradiction


@dataclass(frozen=True, kw_only=True)
class Declared:
    """Declared bounds: while they hold, a valid position is right. Intervals are from sample to sample.

    residual_limit      of usual samples, cycles; as narrowed by the bounds below
    widest_limit        2010:01, cycles: of the first step after a start; None: ``residual_limit``
    acceleration        largest, cycles per interval^2; None: not known
    acceleration_waits  it is declared, but the interval is not known before the second sample
    phase_error         largest of a good sample, cycles
    instant_error       largest of a sampling instant, intervals
    bad                 m: samples in a row that may be bad unnoticed; 0: as many as cannot do harm
    doubt_acceleration  assumed in doubt if ``acceleration`` is not known; 0: none
    coast_samples       intervals of SYNC without a good sample until the position is lost
    samples_per_sync    number of samples in an interval of SYNC
    """

    residual_limit: float = RESIDUAL_LIMIT
    widest_limit: float | None = None
    acceleration: float | None = None
    acceleration_waits: bool = False
    phase_error: float = PHASE_ERROR_CYCLES
    instant_error: float = 0.0
    bad: int = 0
    doubt_acceleration: float = DOUBT_ACCELERATION
    coast_samples: int = COAST_SAMPLES
    samples_per_sync: int = 1

    @property
    def coasting(self) -> int:
        return self.coast_samples * self.samples_per_sync

    @property
    def start_error(self) -> float:
        """The part of :attr:`widest_limit` beyond acceleration and phase errors, cycles."""
        return max(0.0, (self.widest_limit or 0.0) - self.residual_limit)

    @property
    def assumes(self) -> bool:
        return self.acceleration is None and self.doubt_acceleration > 0.0

    @cached_property
    def bad_samples(self) -> int:
        """m: as declared, or as many as do no harm at twice the bound, at least those of a SYNC."""
        if self.bad:
            return self.bad
        # The samples of a SYNC come in one frame with one time, and are bad together.
        return max(self.samples_per_sync, min(samples_without_harm(2.0 * self.followed), MOST_BY_DEFAULT))

    @property
    def followed(self) -> float:
        """Largest acceleration of the motions followed in doubt, cycles per interval^2."""
        return self.in_doubt.largest

    def kept_samples(self, motion: float | None = None) -> int:
        """Missed or flagged samples in a row after which the position is still certain, 0..255.

        ``motion`` is the largest acceleration of the machine, None: :attr:`followed`.
        """
        largest = self.followed if motion is None else min(motion, self.followed)
        most = min(self.coasting, MOST_IN_A_ROW)
        return kept_samples(self.followed, largest, self.phase_error, most)

    @cached_property
    def usual(self) -> BoundedMotion:
        weights = 2.0**ORDER
        widest = max(0.0, self.residual_limit - weights * self.phase_error)
        largest = widest if self.acceleration is None else min(self.acceleration, self.residual_limit)
        error = max(0.0, self.residual_limit - largest) / weights
        return BoundedMotion(largest, error, self.instant_error)

    @cached_property
    def in_doubt(self) -> BoundedMotion:
        largest = self.usual.largest
        if self.assumes:
            largest = min(largest, self.doubt_acceleration)
        return BoundedMotion(largest, self.phase_error, self.instant_error)
