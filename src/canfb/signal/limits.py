"""Limits of the acceleration that eq. 9 allows (paper, eq. 10 and 12)."""

from __future__ import annotations

import math

from canfb.signal.tracker import check_residual_limit

RPM = 60.0 / (2.0 * math.pi)  # of a speed in rad/s


def max_acceleration(
    cycles_per_revolution: float, sample_rate_hz: float, residual_limit: float = 0.5
) -> float:
    """Largest acceleration in rad/s^2 that eq. 9 follows, pi/N fs^2 (eq. 10) at the limit 1/2, in
    proportion to ``residual_limit`` (cycles, 0 < limit <= 0.5).

    ``cycles_per_revolution`` and ``sample_rate_hz`` are positive. ValueError otherwise.
    """
    if not 0.0 < cycles_per_revolution < math.inf:
        raise ValueError(f"cycles_per_revolution must be positive, not {cycles_per_revolution!r}")
    if not 0.0 < sample_rate_hz < math.inf:
        raise ValueError(f"sample_rate_hz must be positive, not {sample_rate_hz!r}")
    limit = check_residual_limit(residual_limit)
    return 2.0 * math.pi / cycles_per_revolution * limit * sample_rate_hz**2


def max_speed(cycles_per_revolution: float, jitter_s: float, residual_limit: float = 1.0 / 3.0) -> float:
    """Largest speed in rad/s that is followed without sample times if SYNC jitters by ``jitter_s``.

    The second difference of eq. 9 multiplies an error v j by up to four: 4 v j < ``residual_limit``
    (cycles, 0 < limit <= 0.5; minus the acceleration). ``cycles_per_revolution`` and
    ``jitter_s`` are positive. ValueError otherwise.
    """
    if not 0.0 < cycles_per_revolution < math.inf:
        raise ValueError(f"cycles_per_revolution must be positive, not {cycles_per_revolution!r}")
    if not 0.0 < jitter_s < math.inf:
        raise ValueError(f"jitter_s must be positive, not {jitter_s!r}")
    return 2.0 * math.pi / cycles_per_revolution * check_residual_limit(residual_limit) / (4.0 * jitter_s)


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
ROUNDING = 1e-9


def safe_deviation(samples: int) -> float:
    """Largest L + a, cycles, at which this many samples (1 or more) in a row cannot falsify the count
    unseen.

    L is the residual limit, a the acceleration in cycles per interval squared (docs/supervision.md).
    """
    changes = samples + 2
    return min(1.0 / changes, 1.0 / (changes * changes // 4))


def samples_without_harm(cycles: float) -> int:
    """The largest number of samples that are safe at L + a = ``cycles``, 0..255."""
    count = 0
    while count < MOST_IN_A_ROW and cycles <= safe_deviation(count + 1) * (1.0 + ROUNDING):
        count += 1
    return count


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
