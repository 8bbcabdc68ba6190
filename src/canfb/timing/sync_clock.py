"""One estimate of SYNC: its period, its phase and its deviation.

Every judgement of time needs to know when the next SYNC is due. A drive learns it with a filter on the
arrivals; so does this clock. What differs is how good the arrivals are:

- A receive time of the bus (*stamped*) is the time of the frame within some 10 us. Early and late mean the
  same, and the filter follows the mean of the deviations.
- Without one, the time of the call is only the latest time at which the frame came. A SYNC cannot come early,
  but a process may be late by any time. So the filter follows the earliest of several arrivals: the phase is
  that of the lower envelope, which a late host does not move. A burst after a stall is late evidence: all of
  it but its last frame is later than a period, and is not used.

The period is first measured, over FIRST_INTERVALS that agree, or as the line below FIRST_CALLS calls. 1006h
is taken in its place only if it agrees with that as far as it is known; it is then more exact, but it is
never believed against what is heard. From there on two numbers are followed, as by the straight line through
all SYNCs: :attr:`SyncClock.due_s` and :attr:`SyncClock.period_s`. At first one SYNC is taken at a time, so
that a poor first period does not add up; later, and without receive times, TOGETHER of them, and at most
MEMORY groups. What the judge refuses does not come here. A clock whose SYNCs are all refused, and all
regular, is set again (:meth:`SyncClock.set_again`).

How far a SYNC may be off starts with what is declared, and never leaves it (deviations.py).

What is declared, and why:

| bound | value | reason |
|---|---|---|
| EARLIEST | 0.5 period | from there on a SYNC is nearer to the one before |
| DRIFT | 2e-4 | two crystals of 100 ppm each |
| LEAST_PERIOD_S | 50 us | the shortest frame takes 47 us at 1 Mbit/s |
| AGREEMENT | 0.2 | intervals of one rate: 135 us of 1 ms for a frame before it, and the producer |
"""

from __future__ import annotations

import math
from itertools import pairwise
from statistics import linear_regression, median

from canfb.timing.deviations import JITTER, TOGETHER, Deviations

EARLIEST = 0.5
DRIFT = 2e-4
LEAST_PERIOD_S = 50e-6
AGREEMENT = 0.2

MEMORY = 32  # groups of them
SINGLE = 24  # SYNCs, until they are taken together
FIRST_INTERVALS = 5  # stamped; all but one agree
TWICE = 0.4  # of the median, below the jitter of two SYNCs of which none is missing
MORE_INTERVALS = 12  # none of them a gap, where SYNC jitters more than that
FIRST_CALLS, MOST_CALLS = 9, 33  # straight enough at once, or as they are
STRAIGHT = 0.1  # period: calls no further above their line come from a host that is not late
OWN = 0.1  # of the squares from the old line; alternately late and in time: 0.4 or more
SAME_PERIOD = 0.03  # of the period: 1006h is that of the bus
RISING = 0.25  # of what all calls of a group were late: a host that is late does that as well


class SyncClock:
    """When SYNCs are due. Times in seconds on the clock of their receptions.

    ``period_s`` is 0.0 until it is known. ``due_s``: when the SYNC after the last counted one is due.
    ``errors`` collects how far usual SYNCs were from it, seconds; :meth:`learn` takes TOGETHER of them.
    """

    __slots__ = (
        "_first",
        "_groups",
        "deviations",
        "due_s",
        "errors",
        "nominal_s",
        "period_s",
        "together",
    )

    def __init__(self) -> None:
        self.nominal_s = 0.0
        """1006h in seconds, 0.0: not written."""
        self.deviations = Deviations()
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
        self._groups = 0
        self.together = TOGETHER
        """SYNCs that are taken together now."""
        self.deviations.forget()

    @property
    def jitter(self) -> float:
        """How far a SYNC may be off, periods."""
        return self.deviations.jitter

    @property
    def deviation(self) -> float:
        """The mean absolute deviation of SYNC from the line, periods."""
        return self.deviations.deviation

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

    def start(self, time_s: float, stamped: bool) -> bool:
        """Another SYNC while the period is not known; True if it is known now."""
        first = self._first
        if not first or time_s > first[-1]:
            first.append(time_s)
        period, last = _measured(first) if stamped else _below(first)
        if period < LEAST_PERIOD_S:
            return False
        if abs(self.nominal_s - period) <= max(SAME_PERIOD * period, _uncertain(first, period, stamped)):
            period = self.nominal_s
        self.period_s, self.due_s = period, last + period
        self._begin_line(len(first) - 1, stamped)
        self._first = []
        return True

    def _begin_line(self, intervals: int, stamped: bool) -> None:
        """The line stands on so many intervals."""
        self.errors.clear()
        self._groups, self.together = (intervals, 1) if stamped else (1, TOGETHER)
        self.deviations.forget()

    def learn(self, stamped: bool) -> None:
        """Follow the group in ``errors``, and empty it."""
        errors, period = self.errors, self.period_s
        size = len(errors)
        mean = sum(errors) / size
        off = mean if stamped else min(errors)
        beyond = off - STRAIGHT * period
        if not stamped and beyond > 0.0:
            off -= (1.0 - RISING) * beyond
        self._groups = n = min(self._groups + 1, MEMORY)
        whole = (n + 1) * (n + 2)
        slope = off * 6.0 / whole / size
        phase_s = off * (4 * n + 2) / whole
        self.deviations.learn(errors, phase_s, period, stamped)
        errors.clear()
        self.due_s += phase_s + slope
        self.period_s = max(period + slope, LEAST_PERIOD_S)
        if size == 1 and n >= SINGLE:
            self.together = TOGETHER
            self._groups = n // TOGETHER
            self.deviations.taken_together()

    def step(self) -> float:
        """Go to the grid to which SYNCs have moved within the noise; by how much, periods; 0.0: none."""
        deviations = self.deviations
        step_s, deviations.step_s = deviations.step_s, 0.0
        if step_s:
            self._groups = 1  # the next group places the line again
        return abs(step_s) / self.period_s

    def is_left_by(self, times_s: list[float]) -> bool:
        """These SYNCs are regular, and on a line of their own, not on this one but for single late ones."""
        if not is_regular(times_s):
            return False
        line = linear_regression(range(len(times_s)), times_s)
        own = [time - line.intercept - n * line.slope for n, time in enumerate(times_s)]
        lags = [(time - self.due_s) / self.period_s for time in times_s]
        off = [(lag - round(lag)) * self.period_s for lag in lags]
        return sum([one * one for one in own]) <= OWN * sum([one * one for one in off])

    def set_again(self, times_s: list[float]) -> None:
        """These SYNCs, all the last ones, are regular, and not where they were due: another rate or phase."""
        self.period_s = (times_s[-1] - times_s[0]) / (len(times_s) - 1)
        self.due_s = times_s[-1] + self.period_s
        self._begin_line(len(times_s) - 1, True)


def _uncertain(times_s: list[float], period_s: float, stamped: bool) -> float:
    """How far the first period may be off: the mean of n intervals by 2/n of the largest deviation of one."""
    if not stamped:
        return 0.0
    apart = [b - a for a, b in pairwise(times_s)]
    return 2.0 / len(apart) * max([min(abs(one - period_s), JITTER * period_s) for one in apart])


def is_regular(times_s: list[float]) -> bool:
    """Whether their distances agree with each other."""
    apart = [b - a for a, b in pairwise(times_s)]
    middle = median(apart)
    return middle >= LEAST_PERIOD_S and max(abs(one - middle) for one in apart) <= AGREEMENT * middle


def _measured(times_s: list[float]) -> tuple[float, float]:
    """Period and last time by stamped times, (0.0, 0.0) if they do not agree; forgets the oldest."""
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
