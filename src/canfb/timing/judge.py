"""The judge: how many intervals may have passed at each sample, and how far its instant may be off.

Time proves little, and this file says no more than that. What the evidence leaves open is handed on as a
set of possible intervals, and the estimator of the cycle count decides with the phases; the next SYNCs may
show which it was (sync_judge.py). Usually it is one interval, and neither SYNC nor sample needs more than
a few comparisons.

A sample belongs to a SYNC by its delay (answer_delay.py), and the intervals are those between SYNCs. Sample
times, where the interface sends them, are judged apart (canfb.signal.sample_times): they say how long it was,
whatever SYNCs were missed or late.

| bound | value | reason |
|---|---|---|
| UNRECEIVED | 1.15 period after a SYNC | the next one is overdue by more than LEAST_EARLY |
| LATER | 0.6 period after the usual delay | it is nearer to the answer of the next SYNC |
"""

from __future__ import annotations

from enum import IntEnum
from math import isfinite
from typing import NamedTuple

from canfb.timing.answer_delay import MOST_LATE, AnswerDelay
from canfb.timing.answer_delay import TOGETHER as DELAYS_TOGETHER
from canfb.timing.since_sample import MOST_INTERVALS
from canfb.timing.sync_judge import MOST_OPTIONS, ROUNDING, SyncJudge

UNRECEIVED = 1.15
LATER = 0.6


class Passed(NamedTuple):
    """Intervals from the last sample to this one.

    elapsed        how many, above 0; or all that are possible, in a tuple
    instant_error  how far the instant of this sample may be off, intervals
    certain        False: what is open may change it
    """

    elapsed: float | tuple[float, ...]
    instant_error: float = 0.0
    certain: bool = True

    @property
    def options(self) -> tuple[float, ...]:
        """All that are possible, the least first; usually one."""
        return self.elapsed if isinstance(self.elapsed, tuple) else (self.elapsed,)


class Refusal(IntEnum):
    """Why a sample is not to be used."""

    EARLIER = 1  # it is an earlier one: the answer to the last SYNC may still come
    ANOTHER = 2  # a second one for a SYNC: which of the two it was is not known


USUAL = Passed(1.0)


class Judge:
    """Give each SYNC to :attr:`syncs`, and the sample that answers it to :meth:`answer`; one that is known to
    belong to the last SYNC to :meth:`answered_last_sync`, and each one to :meth:`free` where there is no
    SYNC. Times are receive times, seconds; ``stamped`` says that the bus gave them.
    """

    __slots__ = ("_count", "advanced", "delay", "syncs")

    def __init__(self) -> None:
        self.delay = AnswerDelay()
        self.syncs = SyncJudge(self.delay)
        self._count = self.syncs.count
        self.advanced = 0
        """SYNCs that were not received, by the last answer: it answers the last of them."""

    def forget(self) -> None:
        """After a reset: another master, another interface."""
        self.syncs.clock.forget()
        self.delay.forget()
        self.pause()

    def pause(self) -> None:
        """The next SYNC begins, and the next sample; what is known of periods and delays stays."""
        self.advanced = 0
        self.syncs.pause()

    def answer(self, time_s: float, stamped: bool) -> Passed | Refusal:
        """Tracks without a sample time have come: the intervals since the last sample."""
        count, delay = self._count, self.delay
        delay_s = time_s - self.syncs.synced_s
        if count.usual and delay.low_s <= delay_s <= delay.high_s and not count.slack:
            unlearned = delay.unlearned
            unlearned.append(delay_s)
            if len(unlearned) >= DELAYS_TOGETHER:
                delay.learn(self.syncs.clock.period_s)
            return self._usual()
        return self._another(time_s, stamped) if count.answered else self._first(time_s, stamped)

    def _usual(self) -> Passed:
        """A sample answers a usual SYNC, and nothing is open."""
        count = self._count
        count.intervals, count.taken, count.slack_before = 0, 1, 0
        count.usual = False
        count.answered = count.sampled = True
        return USUAL

    def _first(self, time_s: float, stamped: bool) -> Passed | Refusal:
        """The first since the last SYNC."""
        syncs, count = self.syncs, self._count
        clock, period = syncs.clock, syncs.clock.period_s
        offsets: tuple[int, ...] = (0,)
        if period and isfinite(time_s):
            delay_s = longest_s = max(0.0, min(time_s - syncs.synced_s, MOST_INTERVALS * period))
            if not stamped:
                # A SYNC that was taken late may have come when it was due; not before that, or hardly.
                longest_s += max(0.0, syncs.synced_s - clock.due_s + (1.0 + syncs.early) * period)
            next_s = clock.due_s - clock.jitter * period - syncs.synced_s if stamped else 0.0
            offsets = self.delay.answers(delay_s, longest_s, period, count.before_open, stamped, next_s)
            if offsets == (0,):
                self.delay.unlearned.append(delay_s)
                early = self._early_s(time_s) / period
                if count.intervals == 1 and early > ROUNDING:
                    count.error = max(count.error, early)
        if offsets != (-1,):
            return self._sampled(offsets)
        # Where the SYNC before has its answer already, more samples come than SYNCs.
        return Refusal.EARLIER if count.before_open or not count.sampled else Refusal.ANOTHER

    def _early_s(self, time_s: float) -> float:
        """How much shorter than a period the interval of a sample is, at least, that is received now.

        It was measured the shortest delay before that time at the latest. So the interval is no longer
        than from the SYNC before to that time; and one that is measured before its SYNC was due is not that
        of a timer. If the last one was off itself, and so was not used, the grid is what is left.
        """
        clock = self.syncs.clock
        grid_s, period_s = clock.due_s - clock.period_s, clock.period_s
        at_s = grid_s if self._count.error_before else min(grid_s, self.syncs.before_s + period_s)
        return at_s - time_s + (self.delay.low_s if self.delay.learned else 0.0)

    def _another(self, time_s: float, stamped: bool) -> Passed | Refusal:
        """No SYNC since the last sample: that one again, or the answer to a SYNC that was not received."""
        syncs = self.syncs
        period = syncs.clock.period_s
        if not syncs.begun:
            return self.free(time_s, stamped)
        if not stamped or not period or not isfinite(time_s):
            return Refusal.ANOTHER
        passed = (time_s - syncs.synced_s) / period
        later = passed - self.delay.mean_s / period
        if passed < UNRECEIVED or later < LATER:
            return Refusal.ANOTHER
        self.advanced = newest = max(1, round(min(later, MOST_INTERVALS)))
        syncs.advance(newest)
        # Unless its delay is the usual one, it may answer one before the newest.
        late = 0 if self.delay.is_usual(time_s - syncs.synced_s) else min(newest - 1, MOST_LATE)
        return self._sampled(tuple(range(-late, 1)))

    def next_is_due(self, time_s: float) -> bool:
        """A SYNC may have come since the last one, and was not received: what comes now may answer it."""
        clock = self.syncs.clock
        return not time_s < clock.due_s - clock.jitter * clock.period_s

    def free(self, time_s: float, stamped: bool) -> Passed | Refusal:
        """Tracks where there is no SYNC: each is its own."""
        verdict = self.syncs.sync(time_s, stamped, None)
        self.syncs.begun = True
        return Refusal.ANOTHER if verdict.extra else self._sampled((0,))

    def _sampled(self, offsets: tuple[int, ...]) -> Passed:
        """A sample that answers the last SYNC, or one that is so many beside it."""
        syncs, count = self.syncs, self._count
        was_answered = count.answered
        low, high = count.take(offsets[0], offsets[-1])
        most = min(high, low + MOST_OPTIONS - 1)
        options, certain = syncs.settle(tuple([float(n) for n in range(low, most + 1)]), high == most)
        count.slack = min(count.slack, MOST_OPTIONS)
        count.lowest = options[0] if count.slack and not syncs.is_open and offsets[0] == 0 else None
        syncs.sample_came(was_answered)
        error = count.error_before
        if len(options) == 1 and certain and not error:
            return USUAL if low == 1 else Passed(options[0])
        return Passed(options[0] if len(options) == 1 else options, error, certain)

    def answered_last_sync(self) -> Passed:
        """A sample that belongs to the last SYNC, whenever it comes."""
        if self._count.usual and not self._count.slack:
            return self._usual()
        return self._sampled((0,))

    def drop(self) -> None:
        """The last sample was not taken after all: parts of it are missing."""
        self._count.give_back()
