"""How long a sampling interval is: from 1006h, and from the SYNCs as they come."""

from __future__ import annotations

import statistics

from canfb.device.dictionary import Entry

SECONDS_PER_US = 1e-6
SMOOTHING = 1.0 / 32.0
LARGEST_STEP = 0.1  # of the period: one interval never moves the estimate by more than SMOOTHING times that
SHORTEST, LONGEST = 0.6, 1.5  # of the period: what lies outside is a gap, a duplicate or another rate
FIRST_INTERVALS = 5  # their median is the first estimate
AGREEMENT = 0.2  # of the median
SLOWER_INTERVALS = 8  # so many long ones that agree are another rate, not gaps


class IntervalEstimate:
    """The sampling interval, seconds.

    :attr:`seconds` is the communication cycle period 1006h where a master has written it, else the
    estimate, 0.0 while nothing is known. :attr:`settled_s` is what times are judged by: the estimate
    once several intervals agree, or 1006h as soon as one interval agrees with it; 0.0 before.
    """

    __slots__ = ("_estimate_s", "_last_s", "_long", "_period_us", "_recent", "settled_s")

    def __init__(self, communication_cycle_period: Entry) -> None:
        self._period_us = communication_cycle_period
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._estimate_s = self.settled_s = 0.0
        self._recent: list[float] = []
        self.pause()

    def pause(self) -> None:
        """Keep the estimate over a pause; the next event starts a new interval."""
        self._last_s: float | None = None
        self._long: list[float] = []

    @property
    def seconds(self) -> float:
        """The sampling interval in force."""
        return self._period_us.value * SECONDS_PER_US or self._estimate_s

    def event(self, now: float) -> None:
        """A SYNC, or a sample where there is no SYNC, at ``now`` (seconds)."""
        last, self._last_s = self._last_s, now
        if last is not None and now > last:
            self.measured(now - last)

    def measured(self, interval_s: float) -> None:
        """One interval of this length, seconds, above 0."""
        period = self.settled_s
        if not period:
            self._settle(interval_s)
        elif interval_s < SHORTEST * period:
            return  # a burst or a duplicate; another rate shows itself in Timeline
        elif interval_s < LONGEST * period:
            step = interval_s - period
            largest = LARGEST_STEP * period
            if not -largest < step < largest:
                step = largest if step > 0.0 else -largest
            self.settled_s = self._estimate_s = period + step * SMOOTHING
            if self._long:
                self._long.clear()
        else:
            self._may_be_slower(interval_s)

    def _settle(self, interval_s: float) -> None:
        recent = self._recent
        recent.append(interval_s)
        del recent[:-FIRST_INTERVALS]
        self._estimate_s = middle = statistics.median(recent)
        nominal = self._period_us.value * SECONDS_PER_US
        if nominal and abs(interval_s - nominal) < AGREEMENT * nominal:
            self.settled_s = self._estimate_s = nominal
        elif len(recent) == FIRST_INTERVALS and _agree(recent, middle) >= FIRST_INTERVALS - 1:
            self.settled_s = middle

    def _may_be_slower(self, interval_s: float) -> None:
        long = self._long
        long.append(interval_s)
        if len(long) < SLOWER_INTERVALS:
            return
        middle = statistics.median(long)
        if _agree(long, middle) >= SLOWER_INTERVALS - 2:
            self.settled_s = self._estimate_s = middle
        long.clear()


def _agree(intervals: list[float], middle: float) -> int:
    return sum(abs(interval - middle) <= AGREEMENT * middle for interval in intervals)
