"""Motions as functions of time: ramps with ripple, moves limited in jerk, and one that can be stopped."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from canfb.signal.phase import FloatArray
from canfb.signal.sample import Sample
from canfb.simulation.encoder import ShaftEncoder


class ShaftMotion(Protocol):
    """Position of a shaft over time, revolutions."""

    def revolutions(self, time_s: float) -> float:
        """Position at ``time_s``."""

    def revolutions_at(self, times_s: FloatArray) -> FloatArray:
        """Positions at these times."""


class PiecewiseCubic:
    """A function of time in pieces, each a polynomial of degree 3 at most; the last one has no end."""

    def __init__(self, speed: float = 0.0) -> None:
        self._starts = [0.0]
        self._pieces = [(0.0, speed, 0.0, 0.0)]

    def state(self, time_s: float) -> tuple[float, float]:
        place = max(0, bisect_right(self._starts, time_s) - 1)
        passed, (value, speed, half, sixth) = time_s - self._starts[place], self._pieces[place]
        return (
            value + passed * (speed + passed * (half + passed * sixth)),
            speed + passed * (2.0 * half + passed * 3.0 * sixth),
        )

    def at(self, times_s: npt.ArrayLike) -> FloatArray:
        times = np.asarray(times_s, dtype=np.float64)
        places = np.maximum(np.searchsorted(self._starts, times, "right") - 1, 0)
        passed = times - np.array(self._starts)[places]
        value, speed, half, sixth = np.moveaxis(np.array(self._pieces)[places], -1, 0)
        found: FloatArray = value + passed * (speed + passed * (half + passed * sixth))
        return found

    def go_on(
        self, from_s: float, speed: float | None = None, acceleration: float = 0.0, jerk: float = 0.0
    ) -> None:
        """From this time on with these; without ``speed`` with that which it has. What was to follow goes."""
        value, before = self.state(from_s)
        kept = bisect_right(self._starts, from_s)
        del self._starts[kept:], self._pieces[kept:]
        self._starts.append(from_s)
        self._pieces.append((value, before if speed is None else speed, acceleration / 2.0, jerk / 6.0))


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
    """Position over time from ``start_rpm`` through ``ramps``, then on at the last speed; with ripple."""

    ramps: tuple[Ramp, ...]
    ripples: tuple[Ripple, ...] = ()
    start_rpm: float = 0.0
    _curve: PiecewiseCubic = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        curve, at_s, speed = PiecewiseCubic(self.start_rpm / 60.0), 0.0, self.start_rpm / 60.0
        for duration_s, end_rpm in self.ramps:
            end = end_rpm / 60.0
            if duration_s > 0.0:
                curve.go_on(at_s, acceleration=(end - speed) / duration_s)
            at_s, speed = at_s + duration_s, end
            curve.go_on(at_s, speed)
        object.__setattr__(self, "_curve", curve)

    def revolutions(self, time_s: float) -> float:
        return self._curve.state(time_s)[0] + float(self._swing(time_s))

    def revolutions_at(self, times_s: npt.ArrayLike) -> FloatArray:
        return self._curve.at(times_s) + self._swing(times_s)

    def _swing(self, time_s: npt.ArrayLike) -> FloatArray | float:
        swing: FloatArray | float = 0.0
        for size_rpm, frequency_hz in self.ripples:
            omega = 2.0 * math.pi * frequency_hz
            swing = swing + size_rpm / 60.0 * (1.0 - np.cos(omega * np.asarray(time_s))) / omega
        return swing


class SCurve:
    """Position over time: at rest until ``start_s``, then to ``speed_rad_s`` at ``end_s`` with limited jerk.

    ValueError unless all are positive, and the speed suffices to reach the acceleration.
    """

    def __init__(
        self, speed_rad_s: float, acceleration_rad_s2: float, jerk_rad_s3: float, start_s: float = 0.0
    ) -> None:
        move = {
            "speed_rad_s": speed_rad_s,
            "acceleration_rad_s2": acceleration_rad_s2,
            "jerk_rad_s3": jerk_rad_s3,
        }
        for name, value in move.items():
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name} must be positive, not {value!r}")
        rise_s = acceleration_rad_s2 / jerk_rad_s3
        level_s = speed_rad_s / acceleration_rad_s2 - rise_s
        if level_s < 0.0:
            raise ValueError(f"speed_rad_s is too low to reach {acceleration_rad_s2:g} rad/s^2")
        speed, acceleration, jerk = (value / (2.0 * math.pi) for value in move.values())
        self.end_s = start_s + 2.0 * rise_s + level_s
        curve = PiecewiseCubic()
        curve.go_on(start_s, jerk=jerk)
        curve.go_on(start_s + rise_s, acceleration=acceleration)
        curve.go_on(start_s + rise_s + level_s, acceleration=acceleration, jerk=-jerk)
        curve.go_on(self.end_s, speed)
        self.revolutions_at = curve.at
        self._curve = curve

    def revolutions(self, time_s: float) -> float:
        return self._curve.state(time_s)[0]


class StoppableMotion:
    """A motion whose own time is brought to a halt, and on again, within ``ramp_s`` seconds each."""

    def __init__(self, motion: ShaftMotion, ramp_s: float) -> None:
        self._motion, self._ramp_s = motion, ramp_s
        self._own_time = PiecewiseCubic(1.0)
        self._changed_s = 0.0
        self.running = True
        """It runs, or is to run."""

    def run(self, running: bool, time_s: float) -> None:
        """Begin to run, or to stop, at ``time_s`` of the machine."""
        if running == self.running:
            return
        self.running, self._changed_s = running, max(time_s, self._changed_s)
        step = float(running) - self._own_time.state(self._changed_s)[1]
        if self._ramp_s:
            self._own_time.go_on(self._changed_s, acceleration=math.copysign(1.0 / self._ramp_s, step))
        self._own_time.go_on(self._changed_s + self._ramp_s * abs(step), float(running))

    def revolutions(self, time_s: float) -> float:
        return self._motion.revolutions(self._own_time.state(time_s)[0])

    def revolutions_at(self, times_s: FloatArray) -> FloatArray:
        return self._motion.revolutions_at(self._own_time.at(times_s))


class MotionSource:
    """An encoder on a machine that moves, whether it is sampled or not; its motion is a function of time.

    :meth:`sample_at` samples at a true time, from the first one on; :meth:`next` lets one interval pass.
    """

    def __init__(self, shaft: ShaftEncoder, motion: ShaftMotion, interval_s: float) -> None:
        self._shaft = shaft
        self.motion = motion
        self._interval_s = interval_s
        self._count = 0
        self._start_s: float | None = None

    @property
    def position_cycles(self) -> float:
        return self._shaft.position_cycles

    def machine_time(self, now: float) -> float:
        if self._start_s is None:
            self._start_s = now
        return max(0.0, now - self._start_s)

    def fast_samples(self, times_s: FloatArray, seed: tuple[int, int]) -> npt.NDArray[np.int16]:
        return self._shaft.fast_samples(self.motion.revolutions_at(times_s), seed)

    def sample_at(self, now: float) -> Sample:
        return self._shaft.sample(self.machine_time(now), self.motion.revolutions)

    def next(self) -> Sample:
        time_s = self._count * self._interval_s
        self._count += 1
        sine, cosine, *_ = self._shaft.sample(time_s, self.motion.revolutions)
        return Sample(sine, cosine)
