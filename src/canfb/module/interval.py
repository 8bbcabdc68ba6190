"""How long an interval of SYNC is: from 1006h, and from the SYNCs as they come."""

from __future__ import annotations

import statistics
from collections import deque

from canfb.device.od.dictionary import Entry

SECONDS_PER_US = 1e-6
SMOOTHING = 1.0 / 32.0
LARGEST_STEP = 0.4  # of the period: what one interval says at most
KNOWN_INTERVALS = 32
SHORTEST, LONGEST = 0.6, 1.5  # of the period: what lies outside is a gap, a duplicate or another rate
USUAL_LONGEST = 1.0 + LARGEST_STEP  # of the period
FIRST_INTERVALS = 5  # their median is the first estimate
AGREEMENT = 0.2  # of the median
LEAST_HEARD = 4  # to confirm 1006h
HEARD_INTERVALS = 32  # where only the time is known at which a SYNC was processed
HEARD_STEP = 8  # of these, from one look at all of them to the next
SLOWER_INTERVALS = 8  # this many long ones that agree are another rate, not gaps


class IntervalEstimate:
    """The interval of SYNC, seconds, and that from one sample to the next.

    :attr:`seconds` is the communication cycle period 1006h where a master has written it, else the
    estimate, 0.0 while nothing is known. :attr:`settled_s` is what times are judged by: the estimate
    once several intervals agree, or 1006h as soon as one interval agrees with it; 0.0 before.
    """

    __slots__ = (
        "_estimate_s",
        "_heard",
        "_heard_left",
        "_intervals",
        "_last_s",
        "_long",
        "_period_us",
        "_recent",
        "samples_per_sync",
        "settled_s",
    )

    def __init__(self, communication_cycle_period: Entry) -> None:
        self._period_us = communication_cycle_period
        self.samples_per_sync = 1
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._estimate_s = self.settled_s = 0.0
        self._intervals = KNOWN_INTERVALS  # that the estimate stands on
        self._recent: list[float] = []
        self.pause()

    def pause(self) -> None:
        """Keep the estimate over a pause; the next event starts a new interval."""
        self._last_s: float | None = None
        self._long: list[float] = []
        self._heard: deque[float] = deque(maxlen=HEARD_INTERVALS + 1)
        self._heard_left = 0  # events until these are looked at again

    @property
    def known_s(self) -> float:
        """The interval of SYNC where it is certain enough for limits; else 0.0."""
        nominal = self._period_us.value * SECONDS_PER_US
        measured = len(self._heard) > FIRST_INTERVALS or len(self._recent) == FIRST_INTERVALS
        return self.settled_s or nominal or (self._estimate_s if measured else 0.0)

    @property
    def seconds(self) -> float:
        """The interval of SYNC in force."""
        return self._period_us.value * SECONDS_PER_US or self._estimate_s

    @property
    def nominal_s(self) -> float:
        """1006h, 0.0: not written."""
        return float(self._period_us.value) * SECONDS_PER_US

    @property
    def sample_s(self) -> float:
        """The sampling interval: that of SYNC, divided by the samples in it."""
        return self.seconds / self.samples_per_sync

    def event(self, now: float, proved: bool = True) -> None:
        """A SYNC, or a sample where there is no SYNC, at ``now`` (seconds).

        ``proved`` says that it came at that time. If it may have come before, only many intervals
        together are measured.
        """
        last, self._last_s = self._last_s, now
        if not proved:
            self._heard.append(now)
            if self._heard_left:
                self._heard_left -= 1
            else:
                self._look_at_heard(now)
        elif last is not None and now > last:
            self.measured(now - last)

    def _look_at_heard(self, now: float) -> None:
        heard = self._heard
        intervals = len(heard) - 1
        if intervals < 1 or now <= heard[0]:
            return
        mean = (now - heard[0]) / intervals
        if not self.settled_s:
            self._estimate_s = mean
            nominal = self._period_us.value * SECONDS_PER_US
            if intervals == HEARD_INTERVALS:
                self.settled_s = mean
            elif intervals >= LEAST_HEARD and abs(mean - nominal) < AGREEMENT * nominal:
                self.settled_s = self._estimate_s = nominal
        elif intervals == HEARD_INTERVALS:
            self._heard_left = HEARD_STEP - 1
            self._approach(mean, HEARD_STEP)

    def measured(self, interval_s: float) -> None:
        """One interval of this length, seconds, above 0."""
        period = self.settled_s
        # The usual one, as _approach would take it.
        usual = SHORTEST * period < interval_s < USUAL_LONGEST * period
        if usual and self._intervals >= KNOWN_INTERVALS and not self._long:
            self.settled_s = self._estimate_s = period + (interval_s - period) * SMOOTHING
        elif not period:
            self._settle(interval_s)
        elif interval_s < SHORTEST * period:
            return  # a burst or a duplicate; another rate shows itself in Timeline
        elif interval_s < LONGEST * period:
            self._approach(interval_s)
            if self._long:
                self._long.clear()
        else:
            self._may_be_slower(interval_s)

    def _approach(self, interval_s: float, intervals: int = 1) -> None:
        """It was this long in the mean over this many new ``intervals``."""
        period = self.settled_s
        step = interval_s - period
        largest = LARGEST_STEP * period
        if not -largest < step < largest:
            step = largest if step > 0.0 else -largest
        self._intervals += intervals
        self.settled_s = self._estimate_s = period + step * max(SMOOTHING, 1.0 / self._intervals) * intervals

    def _settle(self, interval_s: float) -> None:
        recent = self._recent
        recent.append(interval_s)
        del recent[:-FIRST_INTERVALS]
        self._estimate_s = middle = statistics.median(recent)
        nominal = self._period_us.value * SECONDS_PER_US
        if nominal and abs(interval_s - nominal) < AGREEMENT * nominal:
            self.settled_s = self._estimate_s = nominal
            self._intervals = KNOWN_INTERVALS
        elif len(recent) == FIRST_INTERVALS and _agree(recent, middle) >= FIRST_INTERVALS - 1:
            # Their mean: the deviations of SYNCs that follow each other cancel.
            self.settled_s = self._estimate_s = _mean(recent, middle)
            self._intervals = FIRST_INTERVALS

    def _may_be_slower(self, interval_s: float) -> None:
        long = self._long
        long.append(interval_s)
        if len(long) < SLOWER_INTERVALS:
            return
        middle = statistics.median(long)
        if _agree(long, middle) >= SLOWER_INTERVALS - 2:
            self.settled_s = self._estimate_s = _mean(long, middle)
            self._intervals = len(long)
        long.clear()


def _mean(intervals: list[float], middle: float) -> float:
    """Of those that agree with the median."""
    return statistics.mean(interval for interval in intervals if abs(interval - middle) <= AGREEMENT * middle)


def _agree(intervals: list[float], middle: float) -> int:
    return sum(abs(interval - middle) <= AGREEMENT * middle for interval in intervals)
