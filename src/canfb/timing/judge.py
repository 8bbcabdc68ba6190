"""The judge: how many intervals may have passed at each sample, and how far its instant may be off.

Time proves little, and this file says no more than that. What the evidence leaves open is handed on as a
set of possible intervals, and the estimator of the cycle count decides with the phases; what is proved
later is confirmed (sync_judge.py). Usually it is one interval, and neither SYNC nor sample needs more than
a few comparisons.

**Without sample times** the sample belongs to a SYNC by its delay (answer_delay.py), and the intervals are
those between SYNCs. **With sample times** the interface says how long it was, to 100 ns, whatever SYNCs
were missed or late, as long as its witnesses agree (interface_clock.py). A time beyond what count and time
allow, or against its witness, is refused: the sample was taken at its SYNC then, whose jitter is the error
of the instant. At standstill that costs nothing, at speed it is flagged by arithmetic. If no SYNC is there
to which it can belong, it is dropped.

After a clock was set, or a SYNC was off its grid, the instants of MEMORY samples keep that error: the
estimator compares a sample with those that it remembers, on the other side of the step.

| bound | value | reason |
|---|---|---|
| CLOSEST | 0.25 interval | samples closer together give no speed; of a SYNC that was sent twice |
| ABSURD | 2 intervals | a time further off is none; a nearer one may be right, and the SYNC late |
| UNRECEIVED | 1.15 period after a SYNC | from there on the next one is overdue by more than its jitter |
"""

from __future__ import annotations

from enum import IntEnum
from math import inf, isfinite
from typing import NamedTuple

from canfb.timing.answer_delay import TOGETHER as DELAYS_TOGETHER
from canfb.timing.answer_delay import AnswerDelay
from canfb.timing.interface_clock import OFF_GRID, OLDEST, InterfaceClock
from canfb.timing.sync_judge import MEMORY, MOST_INTERVALS, MOST_OPTIONS, SyncJudge

CLOSEST = 0.25
UNRECEIVED = 1.15
ABSURD = 2.0
LATER = 0.6  # period, than usual: the answer to the next SYNC


class Passed(NamedTuple):
    """Intervals from the last sample to this one.

    elapsed        how many, above 0; or all that are possible, in a tuple
    instant_error  how far the instant of this sample may be off, intervals
    certain        False: what is open may change it
    """

    elapsed: float | tuple[float, ...]
    instant_error: float = 0.0
    certain: bool = True


class Refusal(IntEnum):
    """Why a sample is not to be used."""

    EARLIER = 1  # it is an earlier one: the answer to the last SYNC may still come
    ANOTHER = 2  # a second one for a SYNC: which of the two it was is not known


USUAL = Passed(1.0)


class Judge(SyncJudge):
    """Give each SYNC to :meth:`sync`, and the sample that answers it to :meth:`answer`, or to :meth:`stamped`
    if it has a sample time. Times are receive times, seconds; ``proved`` says that the bus gave them.
    """

    def __init__(self) -> None:
        self.interface = InterfaceClock()
        self.delay = AnswerDelay()
        super().__init__()

    def forget(self) -> None:
        """After a reset: another master, another interface."""
        self.clock.forget()
        self.interface.unit_s = 0.0
        self.interface.forget()
        self.delay.forget()
        self.pause()

    def pause(self) -> None:
        """The next SYNC begins, and the next sample; what is known of periods and delays stays."""
        self.interface.pause()
        self._untimed = 0  # periods from the last sample time that was right to the last sample
        self._since_before = 0
        self._set_left, self._set_error = 0, 0.0  # samples since the clock of the interface was set
        super().pause()

    def answer(self, time_s: float, proved: bool) -> Passed | Refusal:
        """Tracks without a sample time have come: the intervals since the last sample."""
        delay = self.delay
        delay_s = time_s - self.synced_s
        if self._usual and delay.low_s <= delay_s <= delay.high_s and not self._slack:
            taken = delay.taken
            taken.append(delay_s)
            if len(taken) >= DELAYS_TOGETHER:
                delay.learn(self.clock.period_s)
            self._since, self._usual = 0, False
            self._answered = self.sampled = True
            return USUAL
        return self._another(time_s, proved) if self._answered else self._first(time_s, proved)

    def _first(self, time_s: float, proved: bool) -> Passed | Refusal:
        """The first since the last SYNC."""
        clock, period = self.clock, self.clock.period_s
        offsets: tuple[int, ...] = (0,)
        if period and isfinite(time_s):
            delay_s = longest_s = max(0.0, min(time_s - self.synced_s, MOST_INTERVALS * period))
            if not proved:
                # A SYNC that was heard late may have come when it was due; not before that, or hardly.
                longest_s += max(0.0, self.synced_s - clock.due_s + (1.0 + self._early) * period)
            offsets = self.delay.answers(delay_s, longest_s, period, self._before_open, proved)
            if offsets == (0,):
                self.delay.taken.append(delay_s)
        return Refusal.EARLIER if offsets == (-1,) else self._sampled(offsets)

    def _another(self, time_s: float, proved: bool) -> Passed | Refusal:
        """No SYNC since the last sample: that one again, or the answer to a SYNC that was not received."""
        period = self.clock.period_s
        if not self.begun:
            return self.free(time_s, proved)
        if not proved or not period or not isfinite(time_s):
            return Refusal.ANOTHER
        passed = (time_s - self.synced_s) / period
        later = passed - self.delay.usual_s / period
        if passed < UNRECEIVED or later < LATER:
            return Refusal.ANOTHER
        self._advance(max(1, round(min(later, MOST_INTERVALS))))
        return self._sampled((0,))

    def free(self, time_s: float, proved: bool) -> Passed | Refusal:
        """Tracks where there is no SYNC: each is its own."""
        verdict = self.sync(time_s, proved, None)
        self.begun = True
        return Refusal.ANOTHER if verdict.extra else self._sampled((0,))

    def _sampled(self, offsets: tuple[int, ...]) -> Passed:
        """A sample that answers the last SYNC, or one that is so many beside it."""
        since = max(1, self._since)
        low, high = max(1, since + offsets[0]), max(1, since + offsets[-1] + self._slack)
        most = min(high, low + MOST_OPTIONS - 1)
        options = tuple([float(n) for n in range(low, most + 1)])
        certain = high == most and not self._uneven
        if self.is_open:
            certain = certain and not (self._offered or self._unclear)
            if not self._offered and len(options) == 1:
                options = self._set
            self._offered = True
        self._slack = min(offsets[-1] - offsets[0], MOST_OPTIONS)
        self._lowest = options[0] if self._slack and not self.is_open and offsets[0] == 0 else None
        self._since_before, self._since = since, max(0, -offsets[-1])
        error = self._error_now()
        self._came()
        if len(options) == 1 and certain and not error:
            return USUAL if low == 1 else Passed(options[0])
        return Passed(options[0] if len(options) == 1 else options, error, certain)

    def _error_now(self) -> float:
        error = self._error if self._error_left else 0.0
        if self._error_left:
            self._error_left -= 1
            if not self._error_left:
                self._error = 0.0
        return error

    def _came(self) -> None:
        self._answered = self.sampled = True
        self._usual, self._more = False, 0.0
        if self._high_s == -inf:
            self._look_ahead()

    def drop(self) -> None:
        """The last sample was not taken after all: parts of it are missing."""
        self._since = min(self._since + max(1, self._since_before), MOST_INTERVALS)
        self._answered = self._usual = False

    def stamped(self, time_100ns: int, time_s: float, proved: bool) -> Passed | Refusal:
        """A sample with its time (2000:05), 0 .. 2^32 - 1, was received at ``time_s``."""
        interface, since = self.interface, self._since
        if self._usual and not (self._untimed or self._set_left):
            took_s = interface.usual(time_100ns, self.synced_s if self._proved else None)
            if took_s:
                self._since, self._usual = 0, False
                self._answered = self.sampled = True
                return tuple.__new__(Passed, (took_s / interface.unit_s, 0.0, True))  # not by its constructor
        if interface.last is None:
            interface.begin(time_100ns, self.synced_s if self._proved else None)
            return self._at_its_sync(0.0)
        interface.choose_unit(time_100ns, self.clock.period_s, since)
        unit_s = interface.unit_s
        period_s = self.clock.period_s or unit_s
        took_s = interface.took_s(time_100ns)
        elapsed = took_s / period_s
        counted, whole = since + self._untimed, round(elapsed)
        least = CLOSEST if self._proved or since > 1 else 1.0 - OFF_GRID  # an answer that is late
        if elapsed - self._untimed >= least and elapsed <= self._most(time_s) + OFF_GRID:
            synced_s = self._synced_s(took_s, time_s)
            after_gap = self._gap or self.is_open
            if interface.is_right(took_s, period_s, synced_s, after_gap):
                interface.take(time_100ns, took_s, synced_s)
                passed, self._untimed = (took_s - self._untimed * period_s) / unit_s, 0
                if whole > counted and (time_s - self.synced_s) > (whole - counted) * period_s:
                    self._advance(whole - counted)
                self._since_before = since
                self._since = max(0, counted - whole) if synced_s != self.synced_s else 0
                self._error_now()
                self._came()
                if not self._set_left:
                    return Passed(passed)
                self._set_left -= 1
                return Passed(passed, self._set_error)
        was_set = interface.refuse(time_100ns, float(max(1, counted)), period_s)
        off = abs(elapsed - counted)
        # The jitter of two SYNCs; or the time is right, and its SYNC was late.
        error = max(2.0 * self.clock.jitter, off if off < ABSURD else 0.0)
        if self._set_left:
            error += self._set_error
        if was_set:
            self._untimed, self._set_left, self._set_error = 0, MEMORY, error
        if not since or self.extra_came or (-OLDEST <= elapsed < CLOSEST and not was_set):
            return Refusal.EARLIER
        if not was_set:
            self._untimed += since
        return self._at_its_sync(error)

    def _at_its_sync(self, error: float) -> Passed:
        """The sample time says nothing: the sample was taken at its SYNC, within the jitter."""
        passed = self._sampled((0,))
        unit_s, period_s = self.interface.unit_s, self.clock.period_s
        if unit_s and period_s and not isinstance(passed.elapsed, tuple):
            passed = passed._replace(elapsed=passed.elapsed * period_s / unit_s)
        return passed if not error else passed._replace(instant_error=max(error, passed.instant_error))

    def _synced_s(self, took_s: float, time_s: float) -> float | None:
        """When the SYNC of a sample was received, the last one or the one before; None: not known."""
        first_s = self.interface.synced_s
        if not self._proved:
            return None
        known = [at for at in (self.synced_s, self._sync_before_s) if isfinite(at) and at <= time_s]
        if first_s is None:
            return known[0] if known else None
        return min(known, key=lambda at: abs(at - first_s - took_s), default=None)

    def _most(self, time_s: float) -> float:
        """Intervals that may have passed since the last sample time, by count and time."""
        period = self.clock.period_s
        most = self._since + self._untimed + self._more + self._slack
        if not period or not isfinite(time_s):
            return max(1.0, most)
        return most + max(0.0, (time_s - self.synced_s) / period // 1.0)
