"""The speeds that a machine can have at a start, or while it is lost: uneven sample times tell them apart.

The truth is y + c + s t with the counted y and whole numbers c and s. At uneven instants s t is no
whole number, and the second difference of a wrong s is off by s times that of the instants. Each s is
followed by itself, and goes where it leaves a window of the declared motion: from two earlier samples, f
apart, to one that is e after the later,

    B e (e + f) / 2 + (eps + tau |v|) (2 + 2 e / f),

for each pair of BASELINES. The neighbours s +- 1 decide: with instants that deviate by sigma (intervals), q
= sqrt(6) sigma / (B + 4 (eps + tau v)). From q = 1.5 on one speed is left after 5 to 8 samples, at 0.4
after 12 to 40, at 0.1 never.
"""

from __future__ import annotations

import math
from copy import copy
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canfb.signal.phase import FloatArray

# 1Vpp encoders give at most 500 kHz; up to twice that their time stamps of 100 ns cost 0.05 cycle.
MOST_TIME_CYCLES = 0.05
MOST_SPEED = 10_000  # cycles per interval, to bound the memory: 1 MHz at 100 Hz
USUAL_SPEED = 2_000  # where the resolution of the times is not known
MOST_SAMPLES = 512  # at q = 0.25 a speed is known after 200 to 400
# Speeds, with the counts each may have had after a gap: to bound time and memory. Windows of 3 cycles for
# the fastest, or of half a cycle more at each sample, are beyond it, and then nothing is decided.
MOST_MOTIONS = 1 << 16
BASELINES = ((1, 2), (1, 3), (2, 3), (2, 4))  # samples back; the first one counts the cycles
SAMPLES_BEFORE = 3  # the newest: as far as these reach back


class Found(NamedTuple):
    """The last two samples by the one speed left: counts from the first sample on, phases, intervals."""

    before: tuple[int, float]
    last: tuple[int, float]
    elapsed: float


class SpeedSet:
    """Follows all speeds up to ``most`` cycles per interval from the next sample on.

    ``largest`` is the acceleration B, cycles per interval^2, ``phase_error`` eps, cycles, ``instant_error``
    tau, intervals.
    """

    def __init__(self, largest: float, phase_error: float, instant_error: float) -> None:
        self._largest, self._error, self._instant_error = largest, phase_error, instant_error
        most = USUAL_SPEED if not instant_error else int(min(MOST_SPEED, MOST_TIME_CYCLES / instant_error))
        self._most = most
        # The last samples, newest first: cycle counts of the speeds that are left, phase, intervals since.
        self._counts: list[npt.NDArray[np.int64]] = []
        self._phases: list[float] = []
        self._since: list[float] = []
        self._gap = 0.0
        self.chance = 2.0 * most + 1.0
        """Speeds that random phases would leave."""
        self._origin: tuple[float, float] | None = None
        self.samples = 0
        """Since the start."""

    @property
    def left(self) -> int:
        return len(self._counts[0]) if self._counts else 1

    def limit(self, largest: float, instant_error: float) -> None:
        self._largest, self._instant_error = largest, instant_error

    def skip(self, elapsed: float) -> None:
        self._gap += elapsed

    def skip_first(self, phase: float) -> None:
        """The first sample; its ``phase`` may be off by half a cycle."""
        self._origin, self._gap = (phase, 0.0), 0.0

    def copy(self) -> SpeedSet:
        other = copy(self)
        other._counts, other._phases, other._since = self._counts[:], self._phases[:], self._since[:]
        return other

    def unite(self, other: SpeedSet) -> None:
        both = np.hstack([np.stack(self._counts), np.stack(other._counts)])
        both = both[:, np.lexsort(both[::-1])]  # np.unique(axis=1) takes four times as long
        differs = (both[:, 1:] != both[:, :-1]).any(axis=0)
        self._counts = list(both[:, np.append(True, differs)])
        self.chance += other.chance

    def feed(self, phase: float, elapsed: float) -> bool:
        """A sample, ``elapsed`` intervals after the last entry; False: it cannot be decided any more."""
        elapsed += self._gap
        self._gap = 0.0
        self.samples += 1
        self._since = [one + elapsed for one in self._since]
        if self.samples == 1:
            counts = np.zeros(1, np.int64)
            if self._origin is not None:
                self._origin = self._origin[0], elapsed
        elif self.samples == 2:
            most = min(math.ceil(self._most * max(1.0, elapsed)), MOST_MOTIONS // 2)
            self._counts = [self._counts[0].repeat(2 * most + 1)]
            counts = np.arange(-most, most + 1)
            if self._origin is not None:
                counts = self._from_origin(*self._origin, counts, phase, elapsed)
        else:
            off, radius = self._window(1, 2, phase)
            lowest = np.ceil(off - radius)
            possible = np.maximum(np.floor(off + radius) - lowest + 1.0, 0.0)
            if not possible.sum() <= MOST_MOTIONS:
                return False
            self.chance *= 2.0 * float(radius[possible > 0.0].max(initial=0.0))
            counts = self._branch(lowest.astype(np.int64), possible.astype(np.int64))
            for later, earlier in BASELINES[1:]:
                if earlier <= len(self._counts):
                    off, radius = self._window(later, earlier, phase)
                    counts = self._keep(np.abs(off + self._counts[later - 1] - counts) <= radius, counts)
        self._counts = [counts, *self._counts[:SAMPLES_BEFORE]]
        self._phases = [phase, *self._phases[:SAMPLES_BEFORE]]
        self._since = [0.0, *self._since[:SAMPLES_BEFORE]]
        return bool(self.left) and self.samples <= MOST_SAMPLES

    def _from_origin(
        self, phase: float, since: float, steps: npt.NDArray[np.int64], newest: float, elapsed: float
    ) -> npt.NDArray[np.int64]:
        speeds = (steps + (newest - self._phases[0])) / elapsed
        first = np.rint(speeds * since + (phase - self._phases[0])).astype(np.int64)
        self._counts = [first]
        return np.asarray(first + steps)

    def _branch(
        self, lowest: npt.NDArray[np.int64], possible: npt.NDArray[np.int64]
    ) -> npt.NDArray[np.int64]:
        self._counts = [one.repeat(possible) for one in self._counts]
        number = np.arange(len(self._counts[0])) - (np.cumsum(possible) - possible).repeat(possible)
        return np.asarray(self._counts[0] + lowest.repeat(possible) + number)

    def _keep(self, kept: npt.NDArray[np.bool_], counts: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        self._counts = [one[kept] for one in self._counts]
        return counts[kept]

    def _window(self, first: int, second: int, phase: float) -> tuple[FloatArray, FloatArray]:
        """How far the line through two samples is ahead of this phase, and how far it may be off a count;
        for each speed, in cycles from the count of sample ``first``, whose place counts from the newest.
        """
        later, earlier = first - 1, second - 1
        elapsed = self._since[later]
        apart = self._since[earlier] - elapsed
        step = (self._counts[later] - self._counts[earlier]) + (self._phases[later] - self._phases[earlier])
        motion = self._largest * elapsed * (elapsed + apart) / 2.0
        weights = 2.0 + 2.0 * elapsed / apart
        radius = motion + weights * (self._error + self._instant_error * np.abs(step) / apart)
        return np.asarray(step * (elapsed / apart) + (self._phases[later] - phase)), np.asarray(radius)

    @property
    def counts(self) -> tuple[int, int]:
        return int(self._counts[0][0]), int(self._counts[1][0])

    @property
    def last_two(self) -> Found:
        last, before = self.counts
        return Found((before, self._phases[1]), (last, self._phases[0]), self._since[1])

    def has(self, count: int) -> bool:
        return bool((self._counts[0] == count).any())
