"""Which speed a machine has by uneven sample times, although a row of the samples may be bad.

A bad sample removes the true speed from a set (:mod:`canfb.signal.speed_set`), or bends its count. So a
hypothesis is followed for each place of a row of m bad samples (2010:0A), and one without: the truth is in
one of them. A speed is found where all that are left are at the same count for two samples, and random
phases would leave any with a probability of at most 1e-5. Sets whose row is further back than their windows
reach are one: there are at most m + 5.
"""

from __future__ import annotations

import math

from canfb.signal.declared import MOST_BAD_SAMPLES
from canfb.signal.doubt import FALSE_ACCEPTANCE
from canfb.signal.speed_set import SAMPLES_BEFORE, Found, SpeedSet

EVEN_SAMPLES = 8  # in a row whose times decide nothing: at q = 0.7 each is one with a probability of 0.11
KNOWN_SAMPLES = 32  # from then on their rms is known; before, the largest difference stands for it
# q: below the first nothing is decided within MOST_WAITING samples of a start; first samples below the second
# show that it is below the first.
TELLING, SILENT = 0.4, 0.1


def longest_decidable_row(largest: float, phase_error: float) -> int:
    """The longest row of bad samples behind the first sample that leaves one count; 1 at least.

    The row of m is a gap of E = m + 1 intervals, whose counts give speeds 1 / E apart, held against the
    next step within B (1 + E) / 2 + eps (2 + 2 / E): less than half of 1 / E.
    """
    row = 1
    while row < MOST_BAD_SAMPLES:
        gap = row + 2.0
        if 2.0 * (largest * (1.0 + gap) / 2.0 + phase_error * (2.0 + 2.0 / gap)) >= 1.0 / gap:
            break
        row += 1
    return row


class BadRow:
    """``speeds`` if the m samples from here on are bad."""

    def __init__(self, speeds: SpeedSet, samples: int, has_assumed: bool) -> None:
        self.speeds = speeds
        self.waits = samples
        """Samples of the row that are still to come."""
        self.taken = 0
        """Samples after the row."""
        self.has_assumed = has_assumed
        """Before the row the speed that was assumed at the start was left."""


class SpeedHypotheses:
    """Follows all speeds from the next sample on; ``bad_samples`` is m.

    The others are those of :class:`SpeedSet`.
    """

    def __init__(self, largest: float, phase_error: float, instant_error: float, bad_samples: int) -> None:
        self._good: SpeedSet | None = SpeedSet(largest, phase_error, instant_error)
        self._rows: list[BadRow] = []
        self._has_assumed = True
        self._bad_samples = bad_samples
        self._largest, self._least = largest, largest + 4.0 * phase_error
        self._largest_off = self._squares = 0.0
        self._even = 0  # samples in a row whose times decide nothing
        self._gap = self._elapsed = 0.0
        self._alone = 0  # samples
        self.samples = 0
        """Since the start."""
        self.left = 0
        """Motions that are left; 0 after false samples in more than one row."""
        self.telling = False
        """The times are uneven enough to tell speeds apart."""
        self.silent = False
        """They are so even that they never will."""

    def expect_bad(self, bad_samples: int) -> None:
        for row in self._rows:
            row.waits += bad_samples - self._bad_samples
        self._bad_samples = bad_samples

    def limit(self, largest: float, instant_error: float) -> None:
        self._least += largest - self._largest
        self._largest = largest
        for one in (self._good, *(row.speeds for row in self._rows)):
            if one is not None:
                one.limit(largest, instant_error)

    def skip(self, elapsed: float) -> None:
        self._gap += elapsed
        if self._good is not None:
            self._good.skip(elapsed)
        for row in self._rows:
            row.speeds.skip(elapsed)

    def feed(self, phase: float, elapsed: float) -> bool:
        """A sample, ``elapsed`` intervals after the last entry; False: it cannot be decided any more."""
        self.samples += 1
        self._look_at_times(elapsed + self._gap)
        self._gap = 0.0
        if self._good is not None:
            self._rows.append(BadRow(self._good.copy(), self._bad_samples, self._has_assumed))
        decidable = all(self._feed_row(row, phase, elapsed) for row in self._rows)
        if self._good is not None:
            decidable &= self._good.feed(phase, elapsed) or not self._good.left
            self._good = self._good if self._good.left else None
        if not decidable:  # too many motions in one of them
            return False
        self._rows = [row for row in self._rows if row.speeds.left]
        past = [row for row in self._rows if row.taken > SAMPLES_BEFORE]
        for row in past[1:]:
            past[0].speeds.unite(row.speeds)
            self._rows.remove(row)
        self.left = self._motions_left()
        self._alone = self._alone + 1 if self.left == 1 else 0
        return bool(self.left)

    def _feed_row(self, row: BadRow, phase: float, elapsed: float) -> bool:
        speeds = row.speeds
        if not row.waits:
            row.taken += 1
            return speeds.feed(phase, elapsed) or not speeds.left
        row.waits -= 1
        if self.samples == 1:
            speeds.skip_first(phase)
        else:
            speeds.skip(elapsed)
        return True

    @property
    def _sets(self) -> list[SpeedSet]:
        good = [] if self._good is None else [self._good]
        return good + [row.speeds for row in self._rows if row.taken]

    def _motions_left(self) -> int:
        taken, waiting = self._sets, [row.speeds for row in self._rows if not row.taken]
        most = max((one.left for one in (*taken, *waiting)), default=0)
        if most != 1:
            return most
        if any(one.samples < 2 for one in (*taken, *waiting)) or (waiting and self._good is None):
            return 2  # each set has one, but not up to the last sample
        return len({one.counts[0] for one in taken})

    def _look_at_times(self, elapsed: float) -> None:
        """The second difference of the instants: its rms is sqrt(6) sigma."""
        off, self._elapsed = abs(elapsed - self._elapsed), elapsed
        if self.samples < 3:
            return
        self._largest_off, self._squares = max(self._largest_off, off), self._squares + off * off
        known = self.samples >= KNOWN_SAMPLES
        q = (math.sqrt(self._squares / (self.samples - 2)) if known else self._largest_off) / self._least
        self._even = self._even + 1 if off < SILENT * self._least else 0
        self.telling, self.silent = q >= TELLING, q < SILENT or self._even >= EVEN_SAMPLES

    @property
    def is_decided(self) -> bool:
        """All that is left is at one count, for two samples."""
        return self._alone > 1

    @property
    def found(self) -> Found | None:
        sets = self._sets
        chance = sum(one.chance for one in sets) if self._good is None else self._good.chance
        return sets[0].last_two if self.is_decided and chance <= FALSE_ACCEPTANCE else None

    def holds(self, count: int) -> bool | None:
        """A speed that is left has this count, that of the speed assumed; None: not known yet."""
        self._has_assumed = self._good is not None and self._good.has(count)
        if any(one.has(count) for one in self._sets):
            return True
        waiting = any(row.has_assumed for row in self._rows if not row.taken)
        return None if waiting else False
