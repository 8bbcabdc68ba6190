"""The speeds that a machine can have at a start, or while it is lost: uneven sample times tell them apart.

Phases one interval apart cannot show whole cycles per interval: the truth is y + c + s t with y as it is
counted and whole numbers c and s. At uneven instants s t is no whole number any more, and the second
difference of a wrong s is off by s times that of the instants. So each s is followed by itself, with the
cycle count of each sample nearest to eq. 9 (after a gap with each that is possible), and goes where it leaves
a window of the declared motion (:mod:`canfb.signal.bounded_motion`). From two earlier samples, f apart, to
one that is e after the later,

    B e (e + f) / 2 + (eps + tau |v|) (2 + 2 e / f).

Each pair of BASELINES gives such a window, a necessary condition. The last two samples are the sharpest for
the motion; where they are close together, or where the errors of the times count, longer ones are sharper:
with all four a speed is known after two thirds of the samples. The neighbours s +- 1 decide: with instants
that deviate by sigma (intervals), q = sqrt(6) sigma / (B + 4 (eps + tau v)). From q = 1.5 on one speed is
left after 5 to 8 samples, at 0.4 after 12 to 40, at 0.1 never (docs/legal-motion.md). The true speed never
goes while what is declared holds.

A bad sample can remove the truth, and leave a speed by chance. So the last one left counts when random
phases would leave any with a probability of at most 1e-5, and when it has lasted for as many more samples as
a row of bad ones may have.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canfb.signal.declared import Declared
from canfb.signal.doubt import FALSE_ACCEPTANCE
from canfb.signal.phase import FloatArray
from canfb.signal.speeds import Place

# 1Vpp encoders give at most 500 kHz; up to twice that their time stamps of 100 ns cost 0.05 cycle.
MOST_TIME_CYCLES = 0.05
MOST_SPEED = 10_000  # cycles per interval, to bound the memory: 1 MHz at 100 Hz
USUAL_SPEED = 2_000  # where the resolution of the times is not known
MOST_SAMPLES = 512  # at q = 0.25 a speed is known after 200 to 400
START_SAMPLES = 8  # at q >= 1 uneven times contradict a wrong speed at a start by sample 5 in 95 %
KNOWN_SAMPLES = 32  # from then on their rms is known; before, the largest difference stands for it
LEAST_SAMPLES = 5  # of uneven times, before these count as even after all
EVEN = 2e-4  # of the interval: drift of two crystals
# Speeds, with the counts each may have had after a gap: to bound time and memory. Windows of 3 cycles for
# the fastest, or of half a cycle more at each sample, are beyond it, and then nothing is decided.
MOST_MOTIONS = 1 << 16
BASELINES = ((1, 2), (1, 3), (2, 3), (2, 4))  # samples back; the first one counts the cycles
SAMPLES_BEFORE = 3  # the newest: as far as these reach back
# q: below the first nothing is told within MOST_WAITING samples; first samples below the second show that it
# is below the first.
TELLING, SILENT = 0.4, 0.1
MOST_WAITING = 64  # samples after a start: at q = 0.4 a wrong speed has gone after 12 to 40


class Found(NamedTuple):
    """The last two samples by the one speed left: counts from the first sample on, phases, intervals."""

    before: tuple[int, float]
    last: tuple[int, float]
    elapsed: float


NOTHING_FOUND = Found((0, 0.0), (0, 0.0), 1.0)


class SpeedSet:
    """Follows all speeds up to ``most`` cycles per interval from the next sample on.

    ``largest`` is the acceleration B, cycles per interval^2, ``phase_error`` eps, cycles, ``instant_error``
    tau, intervals; ``patience``, samples that the last speed has to last.
    """

    def __init__(self, largest: float, phase_error: float, instant_error: float, patience: int) -> None:
        self._largest, self._error, self._instant_error = largest, phase_error, instant_error
        self._patience = patience
        most = USUAL_SPEED if not instant_error else int(min(MOST_SPEED, MOST_TIME_CYCLES / instant_error))
        self._most = most
        # The last samples, newest first: cycle counts of the speeds that are left, phase, intervals since.
        self._counts: list[npt.NDArray[np.int64]] = []
        self._phases: list[float] = []
        self._since: list[float] = []
        self._gap = 0.0
        self._chance = 2.0 * most + 1.0  # speeds that random phases would leave
        self._alone = 0  # samples
        self._largest_off = self._squares = 0.0
        self._even = 0  # samples in a row whose times tell nothing
        self.samples = 0
        """Since the start."""
        self.telling = False
        """The times are uneven enough to tell speeds apart."""
        self.silent = False
        """They are so even that they never will."""

    @property
    def left(self) -> int:
        """Speeds that are left; 0 after a false sample."""
        return len(self._counts[0]) if self._counts else 1

    def skip(self, elapsed: float) -> None:
        """No usable phase after so many intervals."""
        self._gap += elapsed

    def feed(self, phase: float, elapsed: float) -> bool:
        """A sample, ``elapsed`` intervals after the last entry; False: this cannot be decided any more."""
        elapsed += self._gap
        self._gap = 0.0
        self.samples += 1
        self._since = [one + elapsed for one in self._since]
        if self.samples == 1:
            counts = np.zeros(1, np.int64)
        elif self.samples == 2:
            most = min(math.ceil(self._most * max(1.0, elapsed)), MOST_MOTIONS // 2)
            self._counts = [self._counts[0].repeat(2 * most + 1)]
            counts = np.arange(-most, most + 1)
        else:
            off, radius = self._window(1, 2, phase)
            lowest = np.ceil(off - radius)
            possible = np.maximum(np.floor(off + radius) - lowest + 1.0, 0.0)
            if not possible.sum() <= MOST_MOTIONS:
                return False
            self._chance *= 2.0 * float(radius[possible > 0.0].max(initial=0.0))
            counts = self._branch(lowest.astype(np.int64), possible.astype(np.int64))
            for first, second in BASELINES[1:]:
                if second <= len(self._counts):
                    off, radius = self._window(first, second, phase)
                    counts = self._keep(np.abs(off + self._counts[first - 1] - counts) <= radius, counts)
            self._look_at_times(elapsed)
        self._counts = [counts, *self._counts[:SAMPLES_BEFORE]]
        self._phases = [phase, *self._phases[:SAMPLES_BEFORE]]
        self._since = [0.0, *self._since[:SAMPLES_BEFORE]]
        self._alone = self._alone + 1 if self.left == 1 else 0
        return bool(self.left) and self.samples <= MOST_SAMPLES

    def _branch(
        self, lowest: npt.NDArray[np.int64], possible: npt.NDArray[np.int64]
    ) -> npt.NDArray[np.int64]:
        """Each goes on with so many counts, from ``lowest`` ahead of its last on; usually one, or none."""
        self._counts = [one.repeat(possible) for one in self._counts]
        number = np.arange(len(self._counts[0])) - (np.cumsum(possible) - possible).repeat(possible)
        return np.asarray(self._counts[0] + lowest.repeat(possible) + number)

    def _keep(self, kept: npt.NDArray[np.bool_], counts: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """These speeds stay; their counts of the sample that is looked at."""
        self._counts = [one[kept] for one in self._counts]
        return counts[kept]

    def _window(self, first: int, second: int, phase: float) -> tuple[FloatArray, FloatArray]:
        """How far the line through two samples is ahead of this phase, and how far it may be off a count.

        For each speed, in cycles from the count of sample ``first``, whose place counts from the newest.
        """
        later, earlier = first - 1, second - 1
        elapsed = self._since[later]
        apart = self._since[earlier] - elapsed
        step = (self._counts[later] - self._counts[earlier]) + (self._phases[later] - self._phases[earlier])
        motion = self._largest * elapsed * (elapsed + apart) / 2.0
        weights = 2.0 + 2.0 * elapsed / apart
        radius = motion + weights * (self._error + self._instant_error * np.abs(step) / apart)
        return np.asarray(step * (elapsed / apart) + (self._phases[later] - phase)), np.asarray(radius)

    def _look_at_times(self, elapsed: float) -> None:
        least = self._largest + 4.0 * self._error
        # The second difference of the instants: its rms is sqrt(6) sigma.
        off = abs(elapsed - (self._since[1] - self._since[0]))
        self._largest_off, self._squares = max(self._largest_off, off), self._squares + off * off
        known = self.samples >= KNOWN_SAMPLES
        q = (math.sqrt(self._squares / (self.samples - 2)) if known else self._largest_off) / least
        self._even = self._even + 1 if off < SILENT * least else 0
        self.telling, self.silent = q >= TELLING, q < SILENT or self._even >= START_SAMPLES

    @property
    def found(self) -> Found | None:
        """The speed, as soon as it is the only one and no chance."""
        if self._alone <= self._patience or self._chance > FALSE_ACCEPTANCE:
            return None
        last, before = ((int(self._counts[n][0]), self._phases[n]) for n in (0, 1))
        return Found(before, last, self._since[1])

    def has(self, count: int) -> bool:
        """One of the speeds that are left has this cycle count now."""
        return bool((self._counts[0] == count).any())


class SpeedVerdict(Enum):
    """What the speeds that are left say of a sample."""

    UNKNOWN = "nothing: the times are even, or all has been said"
    OPEN = "the times are about to tell the speed"
    FALSE_START = "the machine did not start at the speed that was assumed"
    FOUND = "the speed of a position that was lost"


class Starts:
    """When the speeds are followed: from a start on whose times are uneven, and while the position is lost.

    ``origin`` is the cycle count of the first sample, None where the count is not known.
    """

    def __init__(self, origin: int | None = None) -> None:
        self.origin = origin
        self.active: SpeedSet | None = None
        self.last_two: Found = NOTHING_FOUND
        self._tried = False
        self._is_declared = self._may_be_uneven = False
        self._unit = 1.0  # that of the speeds, in intervals as they are counted now

    def rescale(self, factor: float) -> None:
        """Intervals are counted in another unit from here on: all are this many times longer."""
        self._unit *= factor

    def stop(self) -> None:
        """Whatever comes, these speeds are not followed any more."""
        self.active, self._tried = None, True

    def skip(self, options: tuple[float, ...]) -> None:
        """No usable phase after so many intervals."""
        if self.active is not None:
            self.active.skip(options[0] / self._unit)

    def begin(
        self,
        declared: Declared,
        timed: bool,
        options: tuple[float, ...],
        lost: bool,
        places: Sequence[Place],
        missed: float,
    ) -> bool:
        """Is the next sample to be held against them? ``places`` are the samples of a start that is assumed.

        Since the last of them ``missed`` intervals have passed. Where samples are ``timed`` the first one
        may be the unit of all others, and even by definition: it shows nothing then.
        """
        if self.active is not None or self._tried:
            return self.active is not None
        self._is_declared = declared.acceleration is not None
        self._may_be_uneven = timed and self._is_declared
        even = abs(options[0] - 1.0) <= EVEN + 4.0 * declared.instant_error
        if self.origin is None and even and (lost or not self._may_be_uneven):
            return False
        bound = declared.second_order
        if bound is None or len(options) > 1 or not (lost or places):
            return False
        self.active = speeds = SpeedSet(
            bound.largest, declared.phase_error, declared.instant_error, declared.bad_samples + bound.order
        )
        self._unit = 1.0
        if places:
            self.origin = places[0][0]
        for _, phase, elapsed in places:
            speeds.feed(phase, elapsed)
        speeds.skip(missed)
        return True

    def take(self, phase: float, elapsed: float, lost: bool, count: int | None) -> SpeedVerdict:
        """A sample; ``count`` is that of the speed assumed, None where it is in doubt."""
        speeds = self.active
        if speeds is None or not speeds.feed(phase, elapsed / self._unit):
            self.active = self.origin = None  # what is counted from here on lacks the way up to here
            self._tried |= speeds is None or bool(speeds.left)
            return SpeedVerdict.UNKNOWN
        if lost:
            return self._of_lost(speeds)
        if count is None:
            return SpeedVerdict.OPEN
        if self.origin is not None and not speeds.has(count - self.origin):
            return SpeedVerdict.FALSE_START
        even = speeds.samples >= LEAST_SAMPLES and speeds.silent
        most = MOST_WAITING if speeds.telling else START_SAMPLES
        if speeds.left == 1 or even or speeds.samples > most:
            self.stop()
            return SpeedVerdict.UNKNOWN
        # Without a declared acceleration q is small, and a healthy start would wait for nothing.
        known = speeds.silent and (speeds.samples >= LEAST_SAMPLES or not self._may_be_uneven)
        waits = self._is_declared and not known
        return SpeedVerdict.OPEN if waits else SpeedVerdict.UNKNOWN

    def _of_lost(self, speeds: SpeedSet) -> SpeedVerdict:
        found = speeds.found
        if found is not None:
            self.last_two = found._replace(elapsed=found.elapsed * self._unit)
            self.stop()
            return SpeedVerdict.FOUND
        if speeds.samples > START_SAMPLES and not speeds.telling:
            self.active, self.origin = None, None
        return SpeedVerdict.UNKNOWN
