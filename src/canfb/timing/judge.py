"""The judge: how many intervals may have passed at each sample, and how far its instant may be off.

Time proves little, and this file says no more than that. What the evidence leaves open is handed on as a
set of possible intervals, and the estimator of the cycle count decides with the phases; what is stamped
later is confirmed (sync_judge.py). Usually it is one interval, and neither SYNC nor sample needs more than
a few comparisons.

A sample belongs to a SYNC by its delay (answer_delay.py), and the intervals are those between SYNCs. Sample
times, where the interface sends them, are judged apart (canfb.signal.sample_times): they say how long it was,
whatever SYNCs were missed or late.

| bound | value | reason |
|---|---|---|
| UNRECEIVED | 1.15 period after a SYNC | from there on the next one is overdue by more than its jitter |
"""

from __future__ import annotations

from enum import IntEnum
from math import inf, isfinite
from typing import NamedTuple

from canfb.timing.answer_delay import MOST_LATE, SOONEST, AnswerDelay
from canfb.timing.answer_delay import TOGETHER as DELAYS_TOGETHER
from canfb.timing.sync_judge import MOST_INTERVALS, MOST_OPTIONS, SyncJudge

UNRECEIVED = 1.15
LATER = 0.6  # period, than usual: the answer to the next SYNC
ROUNDING = 1e-6  # of the period: a PDO in the same call as its SYNC is not early by that


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


class Judge(SyncJudge):
    """Give each SYNC to :meth:`sync`, and the sample that answers it to :meth:`answer`; one that is known to
    belong to the last SYNC to :meth:`answered_last_sync`, and each one to :meth:`free` where there is no
    SYNC. Times are receive times, seconds; ``stamped`` says that the bus gave them.
    """

    # Of both classes: more than 30 attributes in a dict cost each frame 3 % of a cycle.
    __slots__ = (
        "_answered",
        "_assumed",
        "_before_open",
        "_before_s",
        "_counter",
        "_debt",
        "_earlier",
        "_early",
        "_error",
        "_error_before",
        "_gap",
        "_high_s",
        "_low_s",
        "_lowest",
        "_next_counter",
        "_offered",
        "_paced",
        "_received_s",
        "_set",
        "_since",
        "_since_before",
        "_slack",
        "_slack_before",
        "_soon",
        "_spare_s",
        "_sparse",
        "_streak",
        "_table",
        "_unclear",
        "_uneven",
        "_usual",
        "_wait_s",
        "advanced",
        "begun",
        "clock",
        "delay",
        "extra_after",
        "extra_came",
        "is_open",
        "late_s",
        "on_followed",
        "overflow",
        "periods",
        "sampled",
        "stamped",
        "synced_s",
        "until",
    )

    def __init__(self) -> None:
        self.delay = AnswerDelay()
        super().__init__()

    def forget(self) -> None:
        """After a reset: another master, another interface."""
        self.clock.forget()
        self.delay.forget()
        self.pause()

    def pause(self) -> None:
        """The next SYNC begins, and the next sample; what is known of periods and delays stays."""
        self._since_before = self._slack_before = 0  # before the last sample
        self.advanced = 0
        """SYNCs that were not received, by the last answer: it answers the last of them."""
        super().pause()

    def answer(self, time_s: float, stamped: bool) -> Passed | Refusal:
        """Tracks without a sample time have come: the intervals since the last sample."""
        delay = self.delay
        delay_s = time_s - self.synced_s
        if self._usual and delay.low_s <= delay_s <= delay.high_s and not self._slack:
            unlearned = delay.unlearned
            unlearned.append(delay_s)
            if len(unlearned) >= DELAYS_TOGETHER:
                delay.learn(self.clock.period_s)
            self._since, self._usual = 0, False
            self._since_before, self._slack_before = 1, 0
            self._answered = self.sampled = True
            return USUAL
        return self._another(time_s, stamped) if self._answered else self._first(time_s, stamped)

    def _first(self, time_s: float, stamped: bool) -> Passed | Refusal:
        """The first since the last SYNC."""
        clock, period = self.clock, self.clock.period_s
        offsets: tuple[int, ...] = (0,)
        if period and isfinite(time_s):
            delay_s = longest_s = max(0.0, min(time_s - self.synced_s, MOST_INTERVALS * period))
            if not stamped:
                # A SYNC that was heard late may have come when it was due; not before that, or hardly.
                longest_s += max(0.0, self.synced_s - clock.due_s + (1.0 + self._early) * period)
            next_s = clock.due_s - clock.jitter * period - self.synced_s if stamped else 0.0
            offsets = self.delay.answers(delay_s, longest_s, period, self._before_open, stamped, next_s)
            if offsets == (0,):
                self.delay.unlearned.append(delay_s)
                early = self._early_s(time_s) / period
                if self._since == 1 and early > ROUNDING:
                    self._error = max(self._error, early)
        return Refusal.EARLIER if offsets == (-1,) else self._sampled(offsets)

    def _early_s(self, time_s: float) -> float:
        """How much shorter than a period the interval of a sample is, at least, that is received now.

        It is measured after its SYNC, and sent no sooner after that than any. So the interval is no longer
        than from the SYNC before to that time; and one that is measured before its SYNC was due is not that
        of a timer. If the last one was off itself, and so was not used, the grid is what is left.
        """
        due_s, period_s = self.clock.due_s, self.clock.period_s
        at_s = due_s - period_s if self._error_before else min(due_s - period_s, self._before_s + period_s)
        return at_s - time_s + (self.delay.low_s if self.delay.learned else 0.0)

    def _another(self, time_s: float, stamped: bool) -> Passed | Refusal:
        """No SYNC since the last sample: that one again, or the answer to a SYNC that was not received."""
        period = self.clock.period_s
        if not self.begun:
            return self.free(time_s, stamped)
        if not stamped or not period or not isfinite(time_s):
            return Refusal.ANOTHER
        passed = (time_s - self.synced_s) / period
        later = passed - self.delay.mean_s / period
        if passed < UNRECEIVED or later < LATER:
            return Refusal.ANOTHER
        self.advanced = newest = max(1, round(min(later, MOST_INTERVALS)))
        self._advance(newest)
        # Unless its delay is the usual one, it may answer one before the newest.
        late = 0 if self.delay.is_usual(time_s - self.synced_s) else min(newest - 1, MOST_LATE)
        return self._sampled(tuple(range(-late, 1)))

    def next_is_due(self, time_s: float) -> bool:
        """A SYNC may have come since the last one, and was not received: what comes now may answer it."""
        clock = self.clock
        return not time_s < clock.due_s - clock.jitter * clock.period_s

    def free(self, time_s: float, stamped: bool) -> Passed | Refusal:
        """Tracks where there is no SYNC: each is its own."""
        verdict = self.sync(time_s, stamped, None)
        self.begun = True
        return Refusal.ANOTHER if verdict.extra else self._sampled((0,))

    def _sampled(self, offsets: tuple[int, ...]) -> Passed:
        """A sample that answers the last SYNC, or one that is so many beside it."""
        since = max(1, self._since) if self.sampled else 1
        low, high = max(1, since + offsets[0]), max(1, since + offsets[-1] + self._slack)
        most = min(high, low + MOST_OPTIONS - 1)
        options = tuple([float(n) for n in range(low, most + 1)])
        certain = high == most and not self._uneven
        if self.is_open:
            certain = certain and not (self._offered or self._unclear)
            if not self._offered and len(options) == 1:
                options = self._set
            self._offered = True
        self._slack_before, self._slack = self._slack, min(offsets[-1] - offsets[0], MOST_OPTIONS)
        self._earlier = max(0, -offsets[0])
        self._lowest = options[0] if self._slack and not self.is_open and offsets[0] == 0 else None
        self._since_before, self._since = since, -offsets[-1]
        error = self._error_before = self._error
        self._came()
        if len(options) == 1 and certain and not error:
            return USUAL if low == 1 else Passed(options[0])
        return Passed(options[0] if len(options) == 1 else options, error, certain)

    def _look_ahead(self) -> None:
        """A SYNC so early that its answer may be sooner than any is looked at, and so is that."""
        super()._look_ahead()
        spare_s = (1.0 / SOONEST - 1.0) * self.delay.low_s
        self._low_s = max(self._low_s, -max(spare_s, ROUNDING * self.clock.period_s))

    def _came(self) -> None:
        if self._answered:  # an interval without a SYNC that was received
            self._sparse.clear()
        self._answered = self.sampled = True
        self._usual = False
        if self._high_s == -inf or self._slack or self._error_before:
            self._look_ahead()

    def answered_last_sync(self) -> Passed:
        """A sample that belongs to the last SYNC, whenever it comes."""
        if self._usual and not self._slack:
            self._since, self._usual = 0, False
            self._since_before, self._slack_before = 1, 0
            self._answered = self.sampled = True
            return USUAL
        return self._sampled((0,))

    def unanswered(self) -> None:
        """The last SYNC has no sample, which was reported already."""
        self._answered, self._usual = True, False
        self._high_s = -inf  # the next SYNC adds to the intervals since the last sample

    def drop(self) -> None:
        """The last sample was not taken after all: parts of it are missing."""
        self._slack = self._earlier = self._slack_before
        self._since = min(self._since + max(1, self._since_before), MOST_INTERVALS)
        self._answered = self._usual = False
