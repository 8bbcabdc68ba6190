"""Moves of a servo, limited in jerk; and the table of an encoder whose tracks are ideal."""

import math

import numpy as np

from tools.faults.machine import Array, exact_table

CYCLES_PER_REVOLUTION, RATE_HZ = 2500, 1000
IDEAL_TABLE = exact_table()


def cycles_of(rad: float) -> float:
    return rad * CYCLES_PER_REVOLUTION / (2.0 * math.pi)


def s_curve(speed: float, acceleration: float, jerk: float, times: Array) -> Array:
    """Positions from standstill at time 0 to ``speed``; one unit of length, one of time."""
    rise = acceleration / jerk
    length = speed / acceleration + rise
    position, v, a, begin = np.zeros_like(times), 0.0, 0.0, 0.0
    x = 0.0
    for duration, j in ((rise, jerk), (length - 2.0 * rise, 0.0), (rise, -jerk), (math.inf, 0.0)):
        t = np.clip(times - begin, 0.0, min(duration, 1e9))
        here = x + v * t + a * t**2 / 2.0 + j * t**3 / 6.0
        position = np.where(times >= begin, here, position)
        if math.isfinite(duration):
            x, v = (
                x + v * duration + a * duration**2 / 2 + j * duration**3 / 6,
                v + a * duration + j * duration**2 / 2,
            )
            a += j * duration
            begin += duration
    return position
