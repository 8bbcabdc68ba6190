"""What the prediction of eq. 9 allows: limits of acceleration (paper, eq. 10 and 12)."""

from __future__ import annotations

import math

from canfb.signal.tracker import check_residual_limit


def max_acceleration(
    cycles_per_revolution: float, sample_rate_hz: float, residual_limit: float = 0.5
) -> float:
    """Largest acceleration in rad/s^2 that eq. 9 follows, pi/N fs^2 (eq. 10) at the limit 1/2.

    A smaller ``residual_limit`` (cycles, 0 < limit <= 0.5) reduces it in proportion: 1/3
    leaves two thirds (section 4 of the paper). ``cycles_per_revolution`` and
    ``sample_rate_hz`` are positive. ValueError otherwise.
    """
    if not 0.0 < cycles_per_revolution < math.inf:
        raise ValueError(f"cycles_per_revolution must be positive, not {cycles_per_revolution!r}")
    if not 0.0 < sample_rate_hz < math.inf:
        raise ValueError(f"sample_rate_hz must be positive, not {sample_rate_hz!r}")
    limit = check_residual_limit(residual_limit)
    return 2.0 * math.pi / cycles_per_revolution * limit * sample_rate_hz**2


def max_jerk(cycles_per_revolution: float, sample_rate_hz: float, residual_limit: float = 0.5) -> float:
    """Largest jerk in rad/s^3 that third-order prediction follows: a jerk j leaves j N/(2 pi) T^3.

    Arguments and errors are those of :func:`max_acceleration`, of which there is no limit then.
    """
    return max_acceleration(cycles_per_revolution, sample_rate_hz, residual_limit) * sample_rate_hz


def max_speed(cycles_per_revolution: float, jitter_s: float, residual_limit: float = 1.0 / 3.0) -> float:
    """Largest speed in rad/s that eq. 9 follows without sample times if SYNC jitters by ``jitter_s``.

    An error j of the sampling instant is an error v j of the position, which the second difference of
    eq. 9 multiplies by up to four: 4 v j < ``residual_limit`` (cycles, 0 < limit <= 0.5; minus the
    acceleration in cycles per interval squared). ``cycles_per_revolution`` and ``jitter_s`` are
    positive. ValueError otherwise.
    """
    if not 0.0 < cycles_per_revolution < math.inf:
        raise ValueError(f"cycles_per_revolution must be positive, not {cycles_per_revolution!r}")
    if not 0.0 < jitter_s < math.inf:
        raise ValueError(f"jitter_s must be positive, not {jitter_s!r}")
    return 2.0 * math.pi / cycles_per_revolution * check_residual_limit(residual_limit) / (4.0 * jitter_s)


# Four times the error of the raw phase without a table (eq. 9 weighs three phases with 1, 2, 1),
# so that a narrowed limit holds before the reference measurement as well.
PHASE_ERROR_MARGIN_CYCLES = 0.05


def narrowed_residual_limit(
    residual_limit: float, max_acceleration_rad_s2: float, cycles_per_revolution: float, interval_s: float
) -> float:
    """Residual limit in cycles when the machine's largest acceleration is known (2010:02).

    An acceleration a leaves the residual a N/(2 pi) T^2, here with a margin for the error of
    an uncorrected phase; never more than ``residual_limit``. ``max_acceleration_rad_s2`` = 0
    means not known. ``interval_s`` is the sampling interval T.
    """
    if max_acceleration_rad_s2 <= 0.0:
        return residual_limit
    expected = cycles_per_interval_squared(max_acceleration_rad_s2, cycles_per_revolution, interval_s)
    return min(residual_limit, expected + PHASE_ERROR_MARGIN_CYCLES)


def cycles_per_interval_squared(
    acceleration_rad_s2: float, cycles_per_revolution: float, interval_s: float
) -> float:
    """An acceleration in rad/s^2 as cycles per sampling interval squared."""
    return acceleration_rad_s2 * cycles_per_revolution / (2.0 * math.pi) * interval_s**2
