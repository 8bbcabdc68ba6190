"""The simulated machine as a source."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from canfb.checks import number
from canfb.signal.sample import Sample
from canfb.sources.protocol import Source, SourceConfig, Surroundings

RevolutionsAt = Callable[[float], float]
"""Position of the shaft in revolutions as a function of its time in seconds."""


class Shaft(Protocol):
    """An encoder on a shaft, see :class:`canfb.simulation.encoder.ShaftEncoder`."""

    @property
    def position_cycles(self) -> float:
        """True position of the last sample, cycles."""

    def sample(self, time_s: float, revolutions_at: RevolutionsAt) -> Sample:
        """The sample at ``time_s`` of the machine."""

    def fast_samples(
        self, revolutions: npt.NDArray[np.float64], seed: tuple[int, int]
    ) -> npt.NDArray[np.int16]:
        """Both tracks at these positions, shape (n, 2), ADC counts; ``seed`` is that of the noise."""


class ShaftMotion(Protocol):
    """Position of a shaft over time, see :class:`canfb.simulation.motion.Motion`."""

    def revolutions(self, time_s: float) -> float:
        """Position at ``time_s``, revolutions."""

    def revolutions_at(self, times_s: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Positions at these times, revolutions."""


@dataclass(frozen=True, kw_only=True)
class MotionSourceConfig(SourceConfig):
    """The machine of the ``simulation:`` section.

    rate_hz   samples per second, 0.1..100000
    """

    kind: str = "motion"
    rate_hz: float = 1000.0

    def __post_init__(self) -> None:
        super().__post_init__()
        number("rate_hz", self.rate_hz)
        if not 0.1 <= self.rate_hz <= 100_000:
            raise ValueError(f"rate_hz must be a number 0.1..100000, not {self.rate_hz!r}")

    def open(self, surroundings: Surroundings) -> Source:
        """The simulated machine."""
        around = surroundings
        return around.simulation.source(around.adc_bits, around.cycles_per_revolution, 1.0 / self.rate_hz)


class MotionSource:
    """An encoder on a machine that moves, whether it is sampled or not; its motion is a function of time.

    :meth:`sample_at` samples at a true time; the motion begins with the first one, or with the first
    recording. :meth:`next` is for a module that samples itself, at the rate of 1 / ``interval_s``: one
    interval passes with every sample. Use one of the two.
    """

    def __init__(self, shaft: Shaft, motion: ShaftMotion, interval_s: float) -> None:
        self._shaft = shaft
        self._motion = motion
        self._interval_s = interval_s
        self._count = 0
        self._start_s: float | None = None

    @property
    def motion(self) -> ShaftMotion:
        """What moves the shaft."""
        return self._motion

    @property
    def position_cycles(self) -> float:
        """True position of the last sample, cycles."""
        return self._shaft.position_cycles

    def machine_time(self, now: float) -> float:
        """The time of the motion, seconds, at the time ``now`` of the node."""
        if self._start_s is None:
            self._start_s = now
        return max(0.0, now - self._start_s)

    def fast_samples(self, times_s: npt.NDArray[np.float64], seed: tuple[int, int]) -> npt.NDArray[np.int16]:
        """Both tracks at these times of the motion, shape (n, 2), in ADC counts."""
        return self._shaft.fast_samples(self._motion.revolutions_at(times_s), seed)

    def sample_at(self, now: float) -> Sample:
        """The sample at the true time ``now`` of the node, seconds."""
        return self._shaft.sample(self.machine_time(now), self._motion.revolutions)

    def next(self) -> Sample:
        """The sample one interval after the one before: both tracks alone."""
        time_s = self._count * self._interval_s
        self._count += 1
        sine, cosine, *_ = self._shaft.sample(time_s, self._motion.revolutions)
        return Sample(sine, cosine)
