"""Which sampling interval a SYNC or a sample belongs to, by its receive time and the SYNC counter.

A frame cannot come early, but it may be heard late. So a receive time that the bus gives proves both;
without one, the time of the call is only the latest time at which the frame may have come: "too early"
is proved, "too late" is not, and the position is withheld until later SYNCs show which it was.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from canfb import objects as od
from canfb.device.moment import NEVER
from canfb.device.od.dictionary import Dictionary
from canfb.module.interval import IntervalEstimate
from canfb.module.response import LEARNED_TOGETHER, Answer, Response

COUNTER_OVERFLOW = 0x1019
PERIODS = od.SUPERVISION_PERIODS
PULLING = 0.25  # period: a SYNC that may have been heard late moves the lock if it is nearer than that
GAIN = 0.2  # of the lock on the SYNCs
REST = 1.0 - GAIN
HALF = 0.5  # period: nearer to this SYNC, or to the one beside it
JITTER_GAIN = 1.0 / 64.0
FOLLOWED_TOGETHER = 8  # SYNCs
FIRST_JITTER = 1.0 / 12.0  # period, mean deviation, before it is measured
JITTERS = 6.0  # mean deviations: so early no SYNC comes
LEAST_EARLY = 0.15  # period
EARLY = 0.75  # period after a SYNC: an ADC PDO that came by then does not answer a later one
CONFIRMING_SYNCS = 2  # on time in a row, after some that may have been late
PATIENCE_SYNCS = 64  # that come on time, a whole period late: then SYNCs were lost
FASTER_SYNCS = 8  # regular SYNCs that all come too early are another rate
RATE_AGREEMENT = 0.25
SHORT = 0.6  # period: SYNCs that are regular and nearer together than that
WHOLE = 0.85  # period: a SYNC this long after the one before is no duplicate of it
FRAME_S = 47e-6  # of a SYNC at 1 Mbit/s: no other one begins sooner
UNSETTLED_S = 0.5  # taken for a period where none is known


class Verdict(NamedTuple):
    """What is known of a SYNC or of a sample.

    unheard    SYNCs before it that were sent, or due, and not heard
    duplicate  it came before: not to be used
    late       it may be late, or SYNCs before it were not heard: later ones decide
    doubt      the number of intervals since the one before cannot be known any more
    """

    unheard: int = 0
    duplicate: bool = False
    late: bool = False
    doubt: bool = False


ON_TIME = Verdict()
DUPLICATE = Verdict(duplicate=True)
LATE = Verdict(late=True)
DOUBT = Verdict(doubt=True)


class Timeline:
    """Locks on the SYNCs as a drive does, and judges each frame by that.

    ``until`` is the time (seconds) after which the position is not valid without another SYNC or
    sample (2010:06), NEVER while nothing is expected. ``withheld`` is above 0 while the position must
    not be called valid. Times are receive times, seconds; ``proved`` says that the bus gave it.
    """

    def __init__(self, dictionary: Dictionary, interval: IntervalEstimate) -> None:
        self._interval = interval
        self._overflow = dictionary.entry(COUNTER_OVERFLOW)
        self._periods = dictionary.entry(*PERIODS)
        self._response = Response()
        self.on_followed: Callable[[float, bool], None] | None = None
        """Called as (time, proved) with every FOLLOWED_TOGETHER-th usual SYNC."""
        self.pause()

    def pause(self) -> None:
        """The next SYNC begins."""
        self.until = NEVER
        self.withheld = 0
        self.late = ("", 0.0)
        """What :attr:`withheld` the position: the frame, and by how much it was late, seconds."""
        self._grid_s: float | None = None  # when this SYNC was due, by the lock
        self._sync_s = 0.0  # when it was heard
        self._heard_s = 0.0  # when the last one was heard, duplicates too
        self._apart_s = 0.0  # and how long after the one before
        self._counter: int | None = None
        self._behind = False
        self._late_syncs = 0
        self._early_syncs = 0
        self._jitter = FIRST_JITTER  # mean deviation from the lock, periods
        self._tolerance = JITTERS * FIRST_JITTER  # periods: a SYNC this much too early does not count
        self._errors: list[float] = []  # of the lock, seconds, which are not in the jitter yet
        self._period_s = 0.0
        self._low_s, self._high_s = NEVER, 0.0  # error of a SYNC that needs no judgement, seconds
        self.after_gap = False
        """A sample was missed since the last one that came: the next may be that one, late."""

    @property
    def jitter_s(self) -> float:
        """Mean deviation of the SYNCs from their lock, seconds."""
        return self._jitter * self._interval.settled_s

    @property
    def begun(self) -> bool:
        """There was a SYNC since the pause."""
        return self._grid_s is not None

    @property
    def synced_s(self) -> float:
        """When the last SYNC was heard, seconds."""
        return self._sync_s

    @property
    def is_behind(self) -> bool:
        """The last SYNC was heard long after it was due: its time says nothing about the period."""
        grid = self._grid_s
        return grid is not None and self._sync_s - grid > PULLING * (self._period_s or NEVER)

    def sync(self, time_s: float, proved: bool, counter: int | None) -> Verdict:
        """A SYNC at ``time_s`` with its ``counter`` (None without 1019h)."""
        grid = self._grid_s
        if grid is not None:
            error = time_s - grid - self._period_s
            if self._low_s < error < self._high_s and (counter is None or self._is_next(counter)):
                self._grid_s = time_s - error * REST
                self._apart_s = time_s - self._heard_s
                self._heard_s = self._sync_s = time_s
                self._counter = counter
                self.until = time_s + self._periods.value * self._period_s
                errors = self._errors
                errors.append(error)
                if len(errors) == FOLLOWED_TOGETHER:
                    self._look_ahead()
                    if self.on_followed is not None:
                        self.on_followed(time_s, proved)
                return ON_TIME
        verdict = self._judged(time_s, proved, counter)
        self._look_ahead()
        return verdict

    def _look_ahead(self) -> None:
        """Which of the next SYNCs need no judgement, and what each of them needs to know.

        Jitter and period change slowly: to look at them with each SYNC would cost more than the rest.
        """
        self._period_s = period = self._interval.settled_s
        self._low_s, self._high_s = NEVER, 0.0
        if not period:
            return
        if errors := self._errors:
            mean = sum(map(abs, errors)) / len(errors) / period
            self._jitter += (mean - self._jitter) * JITTER_GAIN * len(errors)
            errors.clear()
        self._tolerance = min(HALF, max(LEAST_EARLY, JITTERS * self._jitter))
        if not (self.withheld or self._early_syncs):
            self._low_s, self._high_s = -self._tolerance * period, HALF * period

    def _is_next(self, counter: int) -> bool:
        last = self._counter
        if last is None:
            return True
        return counter == last + 1 or (counter == 1 and last == self._overflow.value)

    def _judged(self, time_s: float, proved: bool, counter: int | None) -> Verdict:
        if self._grid_s is None:
            self._take(time_s, time_s, counter)
            return ON_TIME
        period = self._interval.settled_s
        if period and not self.withheld and self._is_on_time(time_s, period, counter):
            return ON_TIME
        counted = self._counted(counter)
        if not period:
            if counter is not None and counter == self._counter and not self._is_apart(time_s):
                return DUPLICATE
            self._take(time_s, time_s, counter)
            return Verdict(unheard=counted) if counted else ON_TIME
        lag = (time_s - self._grid_s) / period - 1.0  # 0 for the next SYNC, on time
        turn = 1 if counter is None else max(1, self._overflow.value)
        return self._decided(time_s, proved, counter, period, lag, counted, turn)

    def _is_on_time(self, time_s: float, period: float, counter: int | None) -> bool:
        """The next SYNC, near the lock, which follows it."""
        assert self._grid_s is not None
        error = time_s - self._grid_s - period
        early = self._tolerance * period
        if not (-early < error < HALF * period and (counter is None or self._is_next(counter))):
            return False
        self._errors.append(error)
        self._take(time_s, self._grid_s + period + error * GAIN, counter)
        if self._apart_s > SHORT * period:
            self._early_syncs = 0
        return True

    def _is_apart(self, time_s: float) -> bool:
        """By what is known so far, this is more than half a period after the last SYNC."""
        rough = self._interval.seconds
        return rough > 0.0 and time_s - self._sync_s > HALF * rough

    def _counted(self, counter: int | None) -> int:
        """SYNCs that the counter says were not heard, but for whole turns of it."""
        overflow = int(self._overflow.value)
        if counter is None or self._counter is None or overflow < 2:
            return 0
        return (counter - self._counter - 1) % overflow

    def _decided(
        self,
        time_s: float,
        proved: bool,
        counter: int | None,
        period: float,
        lag: float,
        counted: int,
        turn: int,
    ) -> Verdict:
        early = lag <= -self._tolerance and (time_s - self._heard_s) < WHOLE * period
        if early and (counter is None or counted == turn - 1):
            return self._too_early(time_s, counter)
        if proved:
            turns = round((lag - counted) / turn)
        else:
            turns = -1 if counted == turn - 1 and turn > 1 and lag < counted - HALF else 0
        unheard = counted + turns * turn
        if unheard < 0 and early:
            return self._too_early(time_s, counter)
        if unheard < 0:
            self._take(time_s, time_s, counter)
            return DOUBT
        error = lag - unheard
        apart = (time_s - self._heard_s) / period
        if error < -HALF or (proved and error > HALF):
            # The counter says what the time forbids: another producer, or one that began again.
            self._take(time_s, time_s, counter)
            return Verdict(unheard=unheard, doubt=True)
        if error >= turn - HALF:
            return self._late(time_s, counter, period, unheard, apart)
        if not proved and error > PULLING:
            error = 0.0  # it was heard late, which proves nothing
        self._take(time_s, self._grid_s_after(unheard, period, error), counter)
        self._confirm(apart, turn)
        return Verdict(unheard=unheard) if unheard else ON_TIME

    def _too_early(self, time_s: float, counter: int | None) -> Verdict:
        """Too early to be another SYNC: a duplicate, or another rate if this goes on and on."""
        if self._behind:
            # More SYNCs came than time allows: some that may have been late were duplicates.
            self._take(time_s, time_s, counter)
            return DOUBT
        apart = time_s - self._heard_s
        regular = abs(apart - self._apart_s) <= RATE_AGREEMENT * self._apart_s
        self._early_syncs = self._early_syncs + 1 if regular and apart > 0.0 else 0
        self._apart_s, self._heard_s = apart, time_s
        if self._early_syncs < FASTER_SYNCS:
            return DUPLICATE
        self._interval.reset()
        self._take(time_s, time_s, counter)
        return DOUBT

    def is_repeated(self, proved: bool, counter: int | None) -> bool:
        """The duplicate that has just come is the SYNC before once more, and not another one."""
        if counter is not None:
            return counter == self._counter
        return proved and self._apart_s < FRAME_S

    def _late(self, time_s: float, counter: int | None, period: float, unheard: int, apart: float) -> Verdict:
        """Late, or some were missed, which is not known: the lock stays where it was."""
        self.withheld = CONFIRMING_SYNCS
        if self._grid_s is not None:
            self.late = ("SYNC", time_s - self._grid_s - (1 + unheard) * period)
        if apart > HALF:
            self._late_syncs += 1
        if self._late_syncs > PATIENCE_SYNCS:
            self._take(time_s, time_s, counter)
            return DOUBT
        self._take(time_s, self._grid_s_after(unheard, period, 0.0), counter)
        self._behind = True
        return Verdict(unheard=unheard, late=True)

    def _confirm(self, apart: float, turn: int) -> None:
        """On time. After some that may have been late this counts only at the pace of the bus.

        A SYNC counter of ``turn`` values says that none is missing.
        """
        if turn > 1:
            self.withheld = 0
        elif self.withheld and (not self._behind or HALF < apart < 1.0 + HALF):
            self.withheld -= 1
        if not self.withheld:
            self._behind = False
            self._late_syncs = 0

    def _grid_s_after(self, unheard: int, period: float, error: float) -> float:
        grid = self._grid_s
        assert grid is not None
        return grid + (1 + unheard + max(-HALF, min(error, HALF)) * GAIN) * period

    def _take(self, time_s: float, grid_s: float, counter: int | None) -> None:
        self._grid_s = grid_s
        self._apart_s = time_s - self._heard_s
        self._heard_s = self._sync_s = time_s
        self._counter = counter
        self._expect(time_s)

    def _expect(self, time_s: float) -> None:
        self.until = time_s + self._periods.value * (self._interval.settled_s or UNSETTLED_S)

    def is_usual_answer(self, time_s: float) -> bool:
        """The first ADC PDO since the last SYNC answers it, as nearly each one does; learn from it.

        False: :meth:`first_sample` knows more.
        """
        delay, response = time_s - self._sync_s, self._response
        if not response.low_s <= delay <= response.high_s:
            return False
        taken = response.taken
        taken.append(delay)
        if len(taken) == LEARNED_TOGETHER:
            response.learn(self._interval.settled_s)
        self.after_gap = False
        return True

    def first_sample(self, time_s: float, proved: bool) -> Verdict:
        """The first ADC PDO since the last SYNC: does it answer that one, or one before or after it?"""
        period = self._interval.settled_s
        if not period or self._grid_s is None:
            return ON_TIME
        delay = longest = time_s - self._sync_s
        if not proved:
            # A SYNC that was heard late may have come when it was due; not before that, or hardly.
            early = self._sync_s - self._grid_s + self._tolerance * period
            if early > 0.0:
                longest += early
        verdict = self._response.judge(delay, longest, period, self.after_gap)
        if verdict is Answer.ON_TIME:
            self.after_gap = False
            return ON_TIME
        if verdict is Answer.LATE:
            return self._unheard(delay, period, proved)
        return DUPLICATE

    def another_sample(self, time_s: float, proved: bool) -> Verdict:
        """A further ADC PDO with no SYNC between: the same one, or the answer to a SYNC not heard."""
        period = self._interval.settled_s
        if not period or self._grid_s is None:
            return DOUBT
        delay = time_s - self._sync_s
        if delay < EARLY * period or (proved and not self._response.is_late(delay, period)):
            return DUPLICATE
        return self._unheard(delay, period, proved)

    def _unheard(self, delay_s: float, period_s: float, proved: bool) -> Verdict:
        """The ADC PDO answers a SYNC that was not heard, if it was not heard late itself."""
        if not proved:
            self.withheld, self._behind = CONFIRMING_SYNCS, True
            self.late = ("sample", delay_s - self._response.usual_s)
            self._look_ahead()
            return LATE
        syncs = max(1, round((delay_s - self._response.usual_s) / period_s))
        self.advance(syncs)
        return Verdict(unheard=syncs)

    def advance(self, intervals: int) -> None:
        """So many SYNCs were due since the last one, and were not heard."""
        period = self._interval.settled_s
        if self._grid_s is None or not period:
            return
        self._grid_s += intervals * period
        self._sync_s += intervals * period
        if self._counter is not None and (overflow := int(self._overflow.value)) > 1:
            self._counter = (self._counter - 1 + intervals) % overflow + 1
        self._expect(self._sync_s)

    def free_running(self, time_s: float, proved: bool) -> Verdict:
        """A sample where there is no SYNC: it is its own."""
        return self.sync(time_s, proved, None)

    def overdue(self, now: float) -> int:
        """Intervals that have passed by ``now`` without a SYNC or a sample; the timeline goes on with them.

        0 where the period is not known: then only the deadline has passed.
        """
        period = self._interval.settled_s
        if not period or self._grid_s is None:
            self.until = NEVER
            return 0
        passed = max(1, int((now - self._sync_s) / period + 1e-6) - 1)
        self.advance(passed)
        self.until = self._sync_s + 2.0 * period
        return passed
