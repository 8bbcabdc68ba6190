"""Motions as functions of time: ramps between speeds with ripple on top; moves that are limited in jerk."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canfb.signal.phase import FloatArray


class Ramp(NamedTuple):
    """A stretch of ``duration_s`` that ends at ``end_rpm``; the speed changes linearly."""

    duration_s: float
    end_rpm: float


class Ripple(NamedTuple):
    """A speed ripple, a sine over time: its amplitude in rpm and its frequency."""

    size_rpm: float
    frequency_hz: float


@dataclass(frozen=True)
class Motion:
    """Position over time: from ``start_rpm`` through ``ramps``, then on at the last speed.

    The ripple starts at phase zero, so the motion starts with the speed ``start_rpm``.
    """

    ramps: tuple[Ramp, ...]
    ripples: tuple[Ripple, ...] = ()
    start_rpm: float = 0.0

    def revolutions(self, time_s: float) -> float:
        """Position in revolutions at ``time_s`` >= 0, zero at the start."""
        position, speed, left = 0.0, self.start_rpm / 60.0, time_s
        for ramp in self.ramps:
            end = ramp.end_rpm / 60.0
            spent = min(left, ramp.duration_s)
            if ramp.duration_s > 0.0:
                position += spent * (speed + (end - speed) * spent / ramp.duration_s / 2.0)
            left -= spent
            if left <= 0.0:
                break
            speed = end
        else:
            position += left * speed
        return position + sum(self._swing(ripple, time_s) for ripple in self.ripples)

    def revolutions_at(self, times_s: npt.ArrayLike) -> FloatArray:
        """:meth:`revolutions` for an array of times."""
        left = np.asarray(times_s, dtype=np.float64)
        position, speed = np.zeros(left.shape), self.start_rpm / 60.0
        for ripple in self.ripples:
            omega = 2.0 * math.pi * ripple.frequency_hz
            position += ripple.size_rpm / 60.0 * (1.0 - np.cos(omega * left)) / omega
        for ramp in self.ramps:
            end = ramp.end_rpm / 60.0
            spent = np.clip(left, 0.0, ramp.duration_s)
            if ramp.duration_s > 0.0:
                position += spent * (speed + (end - speed) * spent / ramp.duration_s / 2.0)
            left = left - spent
            speed = end
        return position + left * speed

    @staticmethod
    def _swing(ripple: Ripple, time_s: float) -> float:
        omega = 2.0 * math.pi * ripple.frequency_hz
        return ripple.size_rpm / 60.0 * (1.0 - math.cos(omega * time_s)) / omega


class SCurve:
    """Position over time: at rest until ``start_s``, then to ``speed_rad_s`` and on at that speed.

    The acceleration rises to ``acceleration_rad_s2`` with ``jerk_rad_s3``, stays there, and falls again.
    ValueError unless all are positive, and the speed suffices to reach that acceleration.
    """

    def __init__(
        self, speed_rad_s: float, acceleration_rad_s2: float, jerk_rad_s3: float, start_s: float = 0.0
    ) -> None:
        for name, value in (
            ("speed_rad_s", speed_rad_s),
            ("acceleration_rad_s2", acceleration_rad_s2),
            ("jerk_rad_s3", jerk_rad_s3),
        ):
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name} must be positive, not {value!r}")
        rise_s = acceleration_rad_s2 / jerk_rad_s3
        level_s = speed_rad_s / acceleration_rad_s2 - rise_s
        if level_s < 0.0:
            raise ValueError(f"speed_rad_s is too low to reach {acceleration_rad_s2:g} rad/s^2")
        jerk = jerk_rad_s3 / (2.0 * math.pi)
        rise, fall, end = start_s + rise_s, start_s + rise_s + level_s, start_s + 2.0 * rise_s + level_s
        # Position is the sum of cubes: each changes the jerk from its instant on.
        self._changes = ((start_s, jerk), (rise, -jerk), (fall, -jerk), (end, jerk))
        self.end_s = end
        """When it has the speed."""

    def revolutions(self, time_s: float) -> float:
        """Position at ``time_s``, revolutions."""
        return sum(change * max(0.0, time_s - at) ** 3 / 6.0 for at, change in self._changes)

    def revolutions_at(self, times_s: npt.ArrayLike) -> FloatArray:
        """:meth:`revolutions` for an array of times."""
        times = np.asarray(times_s, dtype=np.float64)
        found = np.zeros(times.shape)
        for at, change in self._changes:
            found += change * np.maximum(0.0, times - at) ** 3 / 6.0
        return found
