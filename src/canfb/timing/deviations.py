"""How far SYNCs usually are from their line: one of them, and the mean of several.

A SYNC that is further off than any usual one puts its instant in doubt. What is usual has no distribution
that is known beforehand, so two bounds hold, and the smaller one is in force:

- DEVIATIONS mean absolute deviations. Uniform jitter is at most 2 of them; Gaussian jitter is beyond 8 of
  them, 6.4 standard deviations, once in 10^10.
- With receive times BEYOND times the largest deviation of the last 1024 to 2048 SYNCs: of Gaussian jitter
  that is 6.4 standard deviations, too; of jitter with a bound, such as frames that were on the bus, twice
  the bound. Without them this holds for SYNCs that are early alone: a host that is late makes none.

**A step within the noise.** Another producer, a phase d later: if d is less than a single SYNC may be off, no
SYNC shows it, but their mean does. The mean of LASTING groups of n SYNCs is usually off by as much as it was
measured to be, and at least by deviation / sqrt(LASTING n), as if each were on its own; slow wander of a
producer is in the measured one. Beyond DEVIATIONS times that the grid has moved. So a step of 2 standard
deviations is seen within 64 SYNCs, where they are independent; what is smaller time does not show.

| bound | value | reason |
|---|---|---|
| JITTER | 0.45 period | half a period is as near to the next SYNC; measured, it is less after 8 SYNCs |
| LEAST_JITTER_S | 10 us, up to LEAST_JITTER = 0.03 period | noise of a receive time |
"""

from __future__ import annotations

import math

JITTER = 0.45
LEAST_JITTER, LEAST_JITTER_S = 0.03, 10e-6
DEVIATIONS = 8.0  # mean absolute deviations
BEYOND = 2.0  # times the largest deviation
TOGETHER = 8  # SYNCs in a group
SPREADS = 8  # groups, over which the deviation is a mean
PEAKS = 128  # groups, of which the largest deviation is kept, or that of as many before
PEAKS_KNOWN = 8  # groups; with fewer the largest deviation says too little
LASTING = 4  # groups, whose mean shows a step
LEAST_STEP_S = LEAST_JITTER_S / DEVIATIONS
MEANS = 256  # such means, over which their usual deviation is a mean: they overlap, 64 are independent
MEANS_KNOWN = 16  # the jitter of a producer may swing


class Deviations:
    """``deviation`` is the mean absolute one, ``jitter`` how far a SYNC may be off, ``early`` how far before
    its line; all in periods.

    ``step_s`` is by how much SYNCs were off, seconds, if all of the last groups were; else 0.0.
    """

    __slots__ = (
        "_before_s",
        "_groups",
        "_largest_s",
        "_last",
        "_left",
        "_mean_s",
        "_means",
        "_spreads",
        "_usual_s",
        "deviation",
        "early",
        "jitter",
        "step_s",
    )

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """What is declared holds, until it is measured."""
        self.deviation = JITTER / DEVIATIONS
        self.jitter = self.early = JITTER
        self.step_s = 0.0
        self._spreads = self._groups = self._means = 0
        self._largest_s = self._before_s = self._mean_s = 0.0
        self._left = PEAKS
        self._usual_s: list[float] = []  # what their mean is usually off by; the first is of before them
        self._last: list[tuple[float, float]] = []  # groups: their mean, and how far the line was moved then

    def learn(self, errors_s: list[float], moved_s: float, period_s: float, stamped: bool) -> None:
        """A group of SYNCs, or a single one at the start, was off by ``errors_s``.

        The line follows, and is moved by ``moved_s``.
        """
        size = len(errors_s)
        mean_s = sum(errors_s) / size
        # A host that is late is so for a while: what it is late by is no jitter. Slow wander of SYNC is.
        apart = mean_s if size > 1 and not stamped else 0.0
        spread = sum([abs(error - apart) for error in errors_s]) / size / period_s
        self._spreads = min(self._spreads + 1, SPREADS * TOGETHER // size)
        self.deviation += (min(spread, JITTER) - self.deviation) / self._spreads
        if size == 1 and self._spreads < TOGETHER:  # fewer than that say nothing
            return
        limit = DEVIATIONS * self.deviation
        largest = math.inf
        if size > 1:
            self._follow_largest(max(max(errors_s) if stamped else 0.0, -min(errors_s)))
            if self._groups >= PEAKS_KNOWN:
                largest = BEYOND * max(self._largest_s, self._before_s) / period_s
        if stamped and size > 1:
            limit = min(limit, largest)
            self._follow_mean(mean_s, moved_s, period_s * self.deviation / math.sqrt(LASTING * size))
        self.jitter = min(JITTER, max(min(LEAST_JITTER, LEAST_JITTER_S / period_s), limit))
        self.early = min(self.jitter, largest)

    def taken_together(self) -> None:
        """From now on SYNCs come in groups."""
        self._spreads = max(1, self._spreads // TOGETHER)

    def _follow_largest(self, largest_s: float) -> None:
        self._groups += 1
        self._largest_s = max(self._largest_s, largest_s)
        self._left -= 1
        if not self._left:
            self._left, self._before_s, self._largest_s = PEAKS, self._largest_s, 0.0

    def _follow_mean(self, mean_s: float, moved_s: float, least_s: float) -> None:
        """``least_s`` is how far the mean of several groups is off if SYNCs deviate independently."""
        groups = self._last
        groups.append((mean_s, moved_s))
        if len(groups) < LASTING:
            return
        line_s, off_s = 0.0, []  # from the line as it was before these groups
        for mean_s, moved_s in groups:
            off_s.append(line_s + mean_s)
            line_s += moved_s
        mean = abs(sum(off_s)) / LASTING
        if self._means >= MEANS_KNOWN and mean > DEVIATIONS * max(self._usual_s[0], LEAST_STEP_S):
            self.step_s = max(map(abs, off_s))
            groups.clear()
            return
        del groups[0]
        self._means = min(self._means + 1, MEANS)
        self._mean_s += (mean - self._mean_s) / self._means
        self._usual_s = [*self._usual_s[1 - LASTING :], max(self._mean_s, least_s)]
