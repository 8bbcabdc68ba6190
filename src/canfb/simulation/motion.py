"""Motions as functions of time: ramps with ripple, moves limited in jerk, and one that can be stopped."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canfb.signal.phase import FloatArray
from canfb.sources.motion_source import ShaftMotion


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


class _Change(NamedTuple):
    """From ``time_s`` on the rate goes to ``end_rate``; the motion was at its own time ``reached_s`` then."""

    time_s: float
    reached_s: float
    rate: float
    end_rate: float


class StoppableMotion:
    """A motion whose own time can be brought to a halt, and on again, within ``ramp_s`` seconds each.

    So it stops with the acceleration of a ramp of that length from its speed, and goes on where it was.
    Times before keep their positions.
    """

    def __init__(self, motion: ShaftMotion, ramp_s: float) -> None:
        self._motion, self._ramp_s = motion, ramp_s
        self._changes: list[_Change] = []

    @property
    def running(self) -> bool:
        """It runs, or is to run."""
        return not self._changes or self._changes[-1].end_rate > 0.0

    def run(self, running: bool, time_s: float) -> None:
        """Begin to run, or to stop, at ``time_s`` of the machine."""
        if running == self.running:
            return
        if self._changes:
            time_s = max(time_s, self._changes[-1].time_s)
        reached_s, rate = self._state(time_s)
        self._changes.append(_Change(time_s, reached_s, rate, float(running)))

    def revolutions(self, time_s: float) -> float:
        """Position at ``time_s`` of the machine, revolutions."""
        return self._motion.revolutions(self._state(time_s)[0] if self._changes else time_s)

    def revolutions_at(self, times_s: FloatArray) -> FloatArray:
        """:meth:`revolutions` for an array of times."""
        if self._changes:
            times_s = np.array([self._state(float(time_s))[0] for time_s in times_s])
        return self._motion.revolutions_at(times_s)

    def _state(self, time_s: float) -> tuple[float, float]:
        """The own time of the motion at ``time_s``, seconds, and its rate, 0..1."""
        change = next((one for one in reversed(self._changes) if one.time_s <= time_s), None)
        if change is None:
            return time_s, 1.0
        passed = time_s - change.time_s
        step = change.end_rate - change.rate
        ramp_s = self._ramp_s * abs(step)
        if passed >= ramp_s:
            after_s = (passed - ramp_s) * change.end_rate
            return change.reached_s + ramp_s * (change.rate + step / 2.0) + after_s, change.end_rate
        rate = change.rate + step * passed / ramp_s
        return change.reached_s + passed * (change.rate + rate) / 2.0, rate
