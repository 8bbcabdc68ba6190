"""One estimate of SYNC: its period, its phase and its deviation.

Every judgement of time needs to know when the next SYNC is due. A drive learns it with a filter on the
arrivals; so does this clock. What differs is how good the arrivals are:

- A receive time of the bus (*proved*) is the time of the frame within some 10 us. Early and late mean the
  same, and the filter follows the mean of the deviations.
- Without one, the time of the call is only the latest time at which the frame came. A SYNC cannot come early,
  but a process may be late by any time. So the filter follows the earliest of several arrivals: the phase is
  that of the lower envelope, which a late host does not move. A burst after a stall is late evidence: all of
  it but its last frame is later than a period, and is not used.

The period is first measured, over FIRST_INTERVALS that agree, or as the line below FIRST_CALLS calls. 1006h
is taken in its place only if it agrees with that; it is then more exact, but it is never believed against
what is heard. From there on two numbers are followed, as by the straight line through all groups of
TOGETHER SYNCs, at most MEMORY of them: :attr:`SyncClock.due_s` and :attr:`SyncClock.period_s`. What the
judge refuses does not come here. A clock whose SYNCs are all refused, and all regular, is set again
(:meth:`SyncClock.set_again`).

:attr:`SyncClock.deviation` is the mean absolute deviation from the filter. DEVIATIONS times that is what a
SYNC may be off: uniform jitter is at most 2 mean deviations, Gaussian jitter is beyond 6.4 standard
deviations once in 10^10. It starts with what is declared, and never leaves it.

What is declared, and why:

| bound | value | reason |
|---|---|---|
| JITTER | 0.45 period | half a period is as near to the next SYNC; measured, it is less after 8 SYNCs |
| LEAST_JITTER_S | 10 us, up to LEAST_JITTER = 0.03 period | noise of a receive time |
| EARLIEST | 0.5 period | from there on a SYNC is nearer to the one before |
| DRIFT | 2e-4 | two crystals of 100 ppm each |
| LEAST_PERIOD_S | 50 us | the shortest frame takes 47 us at 1 Mbit/s |
| AGREEMENT | 0.2 | intervals of one rate: 135 us of 1 ms for a frame before it, and the producer |
"""

from __future__ import annotations

import math
from itertools import pairwise
from statistics import median

JITTER = 0.45
LEAST_JITTER, LEAST_JITTER_S = 0.03, 10e-6
EARLIEST = 0.5
DRIFT = 2e-4
LEAST_PERIOD_S = 50e-6
AGREEMENT = 0.2

TOGETHER = 8  # SYNCs that are learned from at a time
MEMORY = 32  # groups of them
FIRST_INTERVALS = 5  # proved; all but one agree
TWICE = 0.4  # of the median, below the jitter of two SYNCs of which none is missing
MORE_INTERVALS = 12  # none of them a gap, where SYNC jitters more than that
FIRST_CALLS, MOST_CALLS = 9, 33  # straight enough at once, or as they are
STRAIGHT = 0.1  # period: calls no further above their line come from a host that is not late
SAME_PERIOD = 0.03  # of the period: 1006h is that of the bus
DEVIATIONS = 8.0  # mean absolute deviations
RISING = 0.25  # of what all calls of a group were late: a host that is late does that as well
SPREADS = 8  # groups, over which the deviation is a mean


class SyncClock:
    """When SYNCs are due. Times in seconds on the clock of their receptions.

    ``period_s`` is 0.0 until it is known. ``due_s``: when the SYNC after the last counted one is due.
    ``errors`` collects how far usual SYNCs were from it, seconds; :meth:`learn` takes TOGETHER of them.
    """

    __slots__ = (
        "_first",
        "_groups",
        "_spreads",
        "deviation",
        "due_s",
        "errors",
        "jitter",
        "nominal_s",
        "period_s",
    )

    def __init__(self) -> None:
        self.nominal_s = 0.0
        """1006h in seconds, 0.0: not written."""
        self.forget()

    def forget(self) -> None:
        """Another producer may send SYNC from now on."""
        self.period_s = 0.0
        self.pause()

    def pause(self) -> None:
        """The period is kept; the next SYNC gives the phase."""
        self.due_s = math.nan
        self.errors: list[float] = []
        self._first: list[float] = []
        self._groups = self._spreads = 0
        self.deviation = JITTER / DEVIATIONS
        self.jitter = JITTER
        """How far a SYNC may be off, periods, as measured; up to JITTER."""

    @property
    def known_s(self) -> float:
        """The period, or 1006h before it is known."""
        return self.period_s or self.nominal_s

    @property
    def rough_s(self) -> float:
        """The median of the intervals so far, while the period is not known; 0.0: none."""
        first = self._first
        return median([b - a for a, b in pairwise(first)]) if len(first) > 1 else 0.0

    def begin(self, time_s: float) -> None:
        """The first SYNC after a pause."""
        self.due_s = time_s + self.period_s
        if not self.period_s:
            self._first = [time_s]

    def start(self, time_s: float, proved: bool) -> bool:
        """Another SYNC while the period is not known; True if it is known now."""
        first = self._first
        if not first or time_s > first[-1]:
            first.append(time_s)
        period, last = _measured(first) if proved else _below(first)
        if period < LEAST_PERIOD_S:
            return False
        if abs(self.nominal_s - period) <= SAME_PERIOD * period:
            period = self.nominal_s
        self.period_s, self.due_s = period, last + period
        self._first = []
        self._groups = 1
        return True

    def learn(self, proved: bool) -> None:
        """Follow the group in ``errors``, and empty it."""
        errors, period = self.errors, self.period_s
        size = len(errors)
        mean = sum(errors) / size
        off = mean if proved else min(errors)
        beyond = off - STRAIGHT * period
        if not proved and beyond > 0.0:
            off -= (1.0 - RISING) * beyond
        spread = sum([abs(error - mean) for error in errors]) / size / period
        errors.clear()
        self._groups = n = min(self._groups + 1, MEMORY)
        whole = (n + 1) * (n + 2)
        slope = off * 6.0 / whole / size
        self.due_s += off * (4 * n + 2) / whole + slope
        self.period_s = max(period + slope, LEAST_PERIOD_S)
        self._spreads = min(self._spreads + 1, SPREADS)
        self.deviation += (min(spread, JITTER) - self.deviation) / self._spreads
        least = min(LEAST_JITTER, LEAST_JITTER_S / self.period_s)
        self.jitter = min(JITTER, max(least, DEVIATIONS * self.deviation))

    def set_again(self, times_s: list[float]) -> None:
        """These SYNCs, all the last ones, are regular, and not where they were due: another rate or phase."""
        self.period_s = (times_s[-1] - times_s[0]) / (len(times_s) - 1)
        self.due_s = times_s[-1] + self.period_s
        self.errors.clear()
        self._groups, self._spreads = 1, 0
        self.deviation, self.jitter = JITTER / DEVIATIONS, JITTER


def is_regular(times_s: list[float]) -> bool:
    """Whether their distances agree with each other."""
    apart = [b - a for a, b in pairwise(times_s)]
    middle = median(apart)
    return middle >= LEAST_PERIOD_S and max(abs(one - middle) for one in apart) <= AGREEMENT * middle


def _measured(times_s: list[float]) -> tuple[float, float]:
    """Period and last time by proved times, (0.0, 0.0) if they do not agree; forgets the oldest."""
    del times_s[: -MORE_INTERVALS - 1]
    apart = [b - a for a, b in pairwise(times_s)]
    if len(apart) < FIRST_INTERVALS:
        return 0.0, 0.0
    middle = median(apart)
    last = apart[-FIRST_INTERVALS:]
    agreeing = [one for one in last if abs(one - middle) <= AGREEMENT * middle]
    if len(agreeing) >= FIRST_INTERVALS - 1:
        # Their mean: the deviations of SYNCs that follow each other cancel.
        return sum(agreeing) / len(agreeing), times_s[-1]
    agreeing = [one for one in apart if abs(one - middle) <= TWICE * middle]
    if len(apart) == len(agreeing) == MORE_INTERVALS:
        return sum(agreeing) / len(agreeing), times_s[-1]
    return 0.0, 0.0


def _below(times_s: list[float]) -> tuple[float, float]:
    """Period and last time of the line below the calls, none of which may have come before its SYNC.

    (0.0, 0.0) while too few calls, or none that are straight, are there.
    """
    count = len(times_s)
    if count < FIRST_CALLS:
        return 0.0, 0.0
    hull: list[int] = []
    for n in range(count):
        while len(hull) > 1 and _is_above(times_s, hull[-2], hull[-1], n):
            hull.pop()
        hull.append(n)
    middle = (count - 1) / 2.0
    left, right = next((a, b) for a, b in pairwise(hull) if b >= middle)
    period = (times_s[right] - times_s[left]) / (right - left)
    line = [times_s[left] + (n - left) * period for n in range(count)]
    highest = max(time - at for time, at in zip(times_s, line, strict=True))
    if count < MOST_CALLS and highest > STRAIGHT * period:
        return 0.0, 0.0
    return period, line[-1]


def _is_above(times_s: list[float], a: int, b: int, c: int) -> bool:
    """Point b is on the line from a to c, or above it."""
    return (times_s[b] - times_s[a]) * (c - a) >= (times_s[c] - times_s[a]) * (b - a)
