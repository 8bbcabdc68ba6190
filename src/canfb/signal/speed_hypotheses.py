"""The speed of a machine at a start, or while its position is lost, by uneven sample times.

The true position is y + c + s t, with the counted y and whole c and s. At uneven instants s t is not
whole, and a wrong s is off by s times the second difference of the instants. Each s is followed on its own,
until it leaves a window of the declared motion: e intervals after two samples, f apart, the radius is

    B e (e + f) / 2 + (eps + tau |v|) (2 + 2 e / f),

for each pair of BASELINES. The neighbours s +- 1 decide: with instants that deviate by sigma (intervals),
q = sqrt(6) sigma / (B + 4 (eps + tau v)). From q = 1.5 on, one speed is left after 5 to 8 samples, at 0.4
after 12 to 40, at 0.1 never.

A bad sample may remove the true speed from a :class:`SpeedSet`, or change its count. So one set is followed
for each sample at which a row of m bad ones (2010:0A) may begin, and one without: one of them has the truth.
The speed is found if all sets have one count for two samples, and the false acceptance rate is below 1e-5.
Sets whose row is further back than the windows reach are united: there are at most m + 5.
"""

from __future__ import annotations

import math
from copy import copy
from typing import NamedTuple

import numpy as np

from canfb.signal.bounded_motion import BoundedMotion
from canfb.signal.doubt import FALSE_ACCEPTANCE
from canfb.signal.limits import MOST_BAD_SAMPLES
from canfb.signal.phase import FloatArray, IntArray

# 1 Vpp encoders give at most 500 kHz; at twice that, time stamps of 100 ns cost 0.05 cycle.
MOST_TIME_CYCLES = 0.05
MOST_SPEED = 10_000  # cycles per interval, to bound the memory: 1 MHz at 100 Hz
USUAL_SPEED = 2_000  # the same if the resolution of the times is not known
MOST_SAMPLES = 512  # at q = 0.25 a speed is known after 200 to 400
# Pairs of speed and count (after a gap a speed may have several counts), to bound time and memory. More, as
# with windows of 3 cycles for the fastest or half a cycle wider at each sample, decide nothing.
MOST_MOTIONS = 1 << 16
BASELINES = ((1, 2), (1, 3), (2, 3), (2, 4))  # pairs of samples, counted back; the first one counts cycles
SAMPLES_BEFORE = 3  # samples kept before the newest: as many as BASELINES reach back


# Weights of a key that sorts equal motions side by side. If different motions have one key, equal ones may be
# kept twice, which is safe.
_ORDER = np.array([10**15 + 37, 10**10 + 19, 10**5 + 3, 1])


class Found(NamedTuple):
    """Count (from the first sample) and phase of the last two samples at the one speed left; the interval."""

    before: tuple[int, float]
    last: tuple[int, float]
    elapsed: float


class SpeedSet:
    """Follows all speeds up to ``most`` cycles per interval from the next sample on.

    chance       expected number of speeds left if the phases were random
    samples      since the start; ``taken``: after the row of bad ones
    waits        bad samples still to come
    has_assumed  the speed assumed at the start is left, or was before the row
    """

    def __init__(self, most: int) -> None:
        self._most = most
        # The last samples, newest first: cycle counts at the speeds left, phase, intervals since then.
        self._counts: list[IntArray] = []
        self._phases: list[float] = []
        self._since: list[float] = []
        self._gap = 0.0
        self._origin: tuple[float, float] | None = None
        self.chance = 2.0 * most + 1.0
        self.samples = self.taken = self.waits = 0
        self.has_assumed = True

    @property
    def left(self) -> int:
        return len(self._counts[0]) if self._counts else 1

    def skip(self, elapsed: float) -> None:
        self._gap += elapsed

    def skip_first(self, phase: float) -> None:
        """Take the first sample as a bad one: its ``phase`` may be off by half a cycle."""
        self._origin, self._gap = (phase, 0.0), 0.0

    def before_row(self, samples: int) -> SpeedSet:
        """A copy for the case that the next ``samples`` are bad."""
        other = copy(self)
        other._counts, other.waits, other.taken = self._counts[:], samples, 0
        return other

    def unite(self, other: SpeedSet) -> None:
        both = np.hstack([np.stack(self._counts), np.stack(other._counts)])
        # np.lexsort, which needs no key, takes four times as long.
        both = both[:, np.argsort(_ORDER[: len(both)] @ both, kind="stable")]
        differs = (both[:, 1:] != both[:, :-1]).any(axis=0)
        self._counts = list(both[:, np.append(True, differs)])
        self.chance += other.chance

    def feed(self, phase: float, elapsed: float, motion: BoundedMotion) -> bool:
        """:meth:`SpeedHypotheses.feed`, within the bounds of ``motion``."""
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
            off, radius = self._window(1, 2, phase, motion)
            lowest = np.ceil(off - radius)
            possible = np.maximum(np.floor(off + radius) - lowest + 1.0, 0.0)
            if not possible.sum() <= MOST_MOTIONS:
                return False
            self.chance *= 2.0 * float(radius[possible > 0.0].max(initial=0.0))
            counts = self._branch(lowest.astype(np.int64), possible.astype(np.int64))
            for later, earlier in BASELINES[1:]:
                if earlier <= len(self._counts):
                    off, radius = self._window(later, earlier, phase, motion)
                    kept = np.abs(off + self._counts[later - 1] - counts) <= radius
                    self._counts = [one[kept] for one in self._counts]
                    counts = counts[kept]
        self._counts = [counts, *self._counts[:SAMPLES_BEFORE]]
        self._phases = [phase, *self._phases[:SAMPLES_BEFORE]]
        self._since = [0.0, *self._since[:SAMPLES_BEFORE]]
        return bool(self.left) and self.samples <= MOST_SAMPLES

    def _from_origin(
        self, phase: float, since: float, steps: IntArray, newest: float, elapsed: float
    ) -> IntArray:
        speeds = (steps + (newest - self._phases[0])) / elapsed
        first = np.rint(speeds * since + (phase - self._phases[0])).astype(np.int64)
        self._counts = [first]
        return np.asarray(first + steps)

    def _branch(self, lowest: IntArray, possible: IntArray) -> IntArray:
        self._counts = [one.repeat(possible) for one in self._counts]
        number = np.arange(len(self._counts[0])) - (np.cumsum(possible) - possible).repeat(possible)
        return np.asarray(self._counts[0] + lowest.repeat(possible) + number)

    def _window(
        self, first: int, second: int, phase: float, motion: BoundedMotion
    ) -> tuple[FloatArray, FloatArray]:
        """For each speed, the line through samples ``first`` and ``second`` (counted back) minus ``phase``,
        from the count of ``first``, and the radius of the window; cycles.
        """
        later, earlier = first - 1, second - 1
        elapsed = self._since[later]
        apart = self._since[earlier] - elapsed
        step = (self._counts[later] - self._counts[earlier]) + (self._phases[later] - self._phases[earlier])
        bend = motion.largest * elapsed * (elapsed + apart) / 2.0
        weights = 2.0 + 2.0 * elapsed / apart
        radius = bend + weights * (motion.phase_error + motion.instant_error * np.abs(step) / apart)
        return np.asarray(step * (elapsed / apart) + (self._phases[later] - phase)), np.asarray(radius)

    @property
    def counts(self) -> tuple[int, int]:
        return int(self._counts[0][0]), int(self._counts[1][0])

    @property
    def last_two(self) -> Found:
        return Found((self.counts[1], self._phases[1]), (self.counts[0], self._phases[0]), self._since[1])

    def has(self, count: int) -> bool:
        return bool((self._counts[0] == count).any())


EVEN_SAMPLES = 8  # samples in a row after which times are SILENT: at q = 0.7 each is, with probability 0.11
KNOWN_SAMPLES = 32  # from then on, q is by the rms of the second differences; before, by the largest one
# Values of q: below TELLING nothing is decided within MOST_WAITING samples of a start; if the first samples
# are below SILENT, q is below TELLING.
TELLING, SILENT = 0.4, 0.1


def longest_decidable_row(largest: float, phase_error: float) -> int:
    """The longest row of bad samples after the first sample that leaves one count, at least 1.

    A row of m is a gap of E = m + 1 intervals, whose possible counts give speeds 1 / E apart. The next step
    checks them within B (1 + E) / 2 + eps (2 + 2 / E), which must be below 1 / (2 E).
    """
    decidable = [
        gap - 1
        for gap in range(3, MOST_BAD_SAMPLES + 2)
        if 2.0 * (largest * (1.0 + gap) / 2.0 + phase_error * (2.0 + 2.0 / gap)) < 1.0 / gap
    ]
    return max(decidable, default=1)


class SpeedHypotheses:
    """Follows all speeds within ``motion`` from the next sample on; ``bad_samples`` is m."""

    def __init__(self, motion: BoundedMotion, bad_samples: int) -> None:
        self.motion = motion
        error = motion.instant_error
        most = USUAL_SPEED if not error else int(min(MOST_SPEED, MOST_TIME_CYCLES / error))
        self._good = [SpeedSet(most)]  # the set without bad samples, while there is one
        self._rows: list[SpeedSet] = []  # a set for each sample at which bad ones may begin, oldest first
        self._bad_samples = bad_samples
        self._largest_off = self._squares = 0.0
        self._even = 0  # samples in a row with times below SILENT
        self._gap = self._elapsed = 0.0
        self._alone = 0  # samples in a row with one motion left
        self.samples = 0
        """Samples since the start."""
        self.telling = False
        """The times are uneven enough to distinguish speeds."""
        self.silent = False
        """The times are even, and will decide nothing."""

    def expect_bad(self, bad_samples: int) -> None:
        for row in self._rows:
            row.waits += bad_samples - self._bad_samples
        self._bad_samples = bad_samples

    def skip(self, elapsed: float) -> None:
        self._gap += elapsed
        for one in (*self._good, *self._rows):
            one.skip(elapsed)

    def feed(self, phase: float, elapsed: float) -> bool:
        """Take a sample ``elapsed`` intervals after the last entry; False: nothing can be decided now."""
        self.samples += 1
        self._look_at_times(elapsed + self._gap)
        self._gap = 0.0
        self._rows += [one.before_row(self._bad_samples) for one in self._good]
        decidable = [self._feed(one, phase, elapsed) for one in (*self._good, *self._rows)]
        if not all(decidable):  # too many motions in one of them
            return False
        self._good = [one for one in self._good if one.left]
        self._rows = [row for row in self._rows if row.left]
        past = [row for row in self._rows if row.taken > SAMPLES_BEFORE]
        for row in past[1:]:
            past[0].unite(row)
            self._rows.remove(row)
        self.left = self._motions_left()  # 0 after bad samples in more than one row
        self._alone = self._alone + 1 if self.left == 1 else 0
        return bool(self.left)

    def _feed(self, one: SpeedSet, phase: float, elapsed: float) -> bool:
        if not one.waits:
            one.taken += 1
            return one.feed(phase, elapsed, self.motion) or not one.left
        one.waits -= 1
        if self.samples == 1:
            one.skip_first(phase)
        else:
            one.skip(elapsed)
        return True

    @property
    def _sets(self) -> list[SpeedSet]:
        return [*self._good, *(row for row in self._rows if row.taken)]

    def _motions_left(self) -> int:
        taken, waiting = self._sets, [row for row in self._rows if not row.taken]
        most = max((one.left for one in (*taken, *waiting)), default=0)
        if most != 1:
            return most
        if any(one.samples < 2 for one in (*taken, *waiting)) or (waiting and not self._good):
            return 2  # each set has one motion, but a set may lack the last samples
        return len({one.counts[0] for one in taken})

    def _look_at_times(self, elapsed: float) -> None:
        """Find q by the second differences of the instants, whose rms is sqrt(6) sigma."""
        off, self._elapsed = abs(elapsed - self._elapsed), elapsed
        if self.samples < 3:
            return
        least = self.motion.largest + 4.0 * self.motion.phase_error
        self._largest_off, self._squares = max(self._largest_off, off), self._squares + off * off
        known = self.samples >= KNOWN_SAMPLES
        q = (math.sqrt(self._squares / (self.samples - 2)) if known else self._largest_off) / least
        self._even = self._even + 1 if off < SILENT * least else 0
        self.telling, self.silent = q >= TELLING, q < SILENT or self._even >= EVEN_SAMPLES

    @property
    def is_decided(self) -> bool:
        """True if all motions left have had one count for two samples."""
        return self._alone > 1

    @property
    def found(self) -> Found | None:
        sets = self._sets
        chance = sum(one.chance for one in self._good or sets)
        return sets[0].last_two if self.is_decided and chance <= FALSE_ACCEPTANCE else None

    def holds(self, count: int) -> bool | None:
        """True if a speed left has ``count``, that of the assumed speed; None: not known yet."""
        for good in self._good:
            good.has_assumed = good.has(count)
        if any(one.has(count) for one in self._sets):
            return True
        waiting = any(row.has_assumed for row in self._rows if not row.taken)
        return None if waiting else False
