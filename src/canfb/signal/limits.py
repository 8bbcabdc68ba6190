"""Limits of the acceleration that eq. 9 allows (paper, eq. 10 and 12), and what follows from what the user
declares of machine, encoder and bus.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

from canfb.checks import LARGEST
from canfb.signal.bounded_motion import ORDER, BoundedMotion
from canfb.signal.tracker import RESIDUAL_LIMIT, check_residual_limit

RPM = 60.0 / (2.0 * math.pi)  # of a speed in rad/s


def max_acceleration(
    cycles_per_revolution: float, sample_rate_hz: float, residual_limit: float = 0.5
) -> float:
    """Largest acceleration in rad/s^2 that eq. 9 follows, pi/N fs^2 (eq. 10) at the limit 1/2, in
    proportion to ``residual_limit`` (cycles, 0 < limit <= 0.5).

    ``cycles_per_revolution`` and ``sample_rate_hz`` are positive. ValueError otherwise.
    """
    _check_positive(cycles_per_revolution=cycles_per_revolution, sample_rate_hz=sample_rate_hz)
    limit = check_residual_limit(residual_limit)
    return 2.0 * math.pi / cycles_per_revolution * limit * sample_rate_hz * sample_rate_hz


def max_speed(cycles_per_revolution: float, jitter_s: float, residual_limit: float = 1.0 / 3.0) -> float:
    """Largest speed in rad/s that is followed without sample times if SYNC jitters by ``jitter_s``.

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


# The default of 2010:0C: the error of the raw phase without a table. Eq. 9 weighs three phases with 1, 2, 1:
# with a margin of four times this error a narrowed limit holds before the reference measurement as well.
PHASE_ERROR_CYCLES = 0.0125
MOST_PHASE_ERROR_CYCLES = 0.0625  # of 2010:0C: a sixteenth of a cycle, more is no encoder
# The least that is written after a measurement: temperature and age take half of what a table has removed.
CALIBRATED_PHASE_ERROR_CYCLES = 0.005


def narrowed_residual_limit(
    residual_limit: float,
    max_acceleration_rad_s2: float,
    cycles_per_revolution: float,
    interval_s: float,
    margin_cycles: float = math.inf,
    phase_error_cycles: float = PHASE_ERROR_CYCLES,
) -> float:
    """Residual limit in cycles when the machine's largest acceleration is known (2010:02): a N/(2 pi) T^2,
    and four times the largest error of a phase (2010:0C) or ``margin_cycles``; at most ``residual_limit``.

    ``max_acceleration_rad_s2`` = 0: not known. ``interval_s`` is the sampling interval T.
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
SHARP = 1.0 / 6.0  # cycle: beyond it, a single missed sample may lose the position (docs/supervision.md)
ROUNDING = 1e-9


def samples_without_harm(cycles: float) -> int:
    """The largest number of samples in a row, 0..255, that cannot falsify the count unseen.

    ``cycles`` is L + a, the residual limit and the acceleration in cycles per interval squared
    (docs/supervision.md). Between motions with exact phases there is as much room.
    """
    return kept_samples(cycles, 0.0, 0.0)


def kept_samples(
    accepted_cycles: float,
    motion_cycles: float,
    phase_error_cycles: float,
    most: int = MOST_IN_A_ROW,
) -> int:
    """Missed or flagged samples in a row, 0..``most``, after which one motion is left, for any phases.

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
    0.1  # default of 2010:0B, cycles per interval^2: one to three missed samples are unique up to it
)
COAST_SAMPLES = 3  # default of 2010:03
MOST_BAD_SAMPLES = 8  # 2010:0A; what the estimator remembers is enough for them
MOST_BY_DEFAULT = 3  # each one more multiplies what a contradiction costs


@dataclass(frozen=True, kw_only=True)
class Declared:
    """Bounds while which hold a valid position is right. Intervals are those from sample to sample.

    residual_limit      of usual samples, cycles; in force, so narrowed by what is declared below
    widest_limit        2010:01, cycles: of the first step after a start; None: ``residual_limit``
    acceleration        largest, cycles per interval^2; None: not known
    acceleration_waits  it is declared, but not yet in which interval: the second sample shows it
    phase_error         largest of a good sample, cycles
    instant_error       largest of a sampling instant, intervals
    bad                 m: samples in a row that may be bad unnoticed; 0: as many as cannot do harm
    doubt_acceleration  assumed in doubt if ``acceleration`` is not known; 0: none is
    coast_samples       intervals of SYNC without a good sample until the position is lost
    samples_per_sync    in one of SYNC: all other intervals are those from sample to sample
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
        """The part of :attr:`widest_limit` that no acceleration and no phase error explains, cycles."""
        return max(0.0, (self.widest_limit or 0.0) - self.residual_limit)

    @property
    def assumes(self) -> bool:
        return self.acceleration is None and self.doubt_acceleration > 0.0

    @cached_property
    def bad_samples(self) -> int:
        """m: as declared, or as many as do no harm at twice the bound; at least a SYNC's."""
        if self.bad:
            return self.bad
        # They have one time, and come together.
        return max(self.samples_per_sync, min(samples_without_harm(2.0 * self.followed), MOST_BY_DEFAULT))

    @property
    def followed(self) -> float:
        """Largest acceleration of the motions followed in doubt, cycles per interval^2."""
        return self.in_doubt.largest

    def kept_samples(self, motion: float | None = None) -> int:
        """Missed or flagged samples in a row after which the position is certain, 0..255.

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
