"""What a SYNC shows: how many periods have passed, whether others are missing, whether its instant is good.

A SYNC falls into a zone, by its lag behind the time at which it was due and by its counter:

| zone | what it means | nothing open | SYNCs may be missing |
|---|---|---|---|
| EARLY | sooner than a SYNC can come, shortly after one | extra | more came than can be: doubt |
| ON | within the jitter; whole periods between are missed SYNCs | so many | all came: confirmed |
| OFF | stamped, and further off than the jitter | so many, off by that | the same |
| BEHIND | not stamped, and a period late or more | open | still open |
| AGAINST | the counter says what time forbids | doubt | doubt |

**Late, or missing.** Without receive times and counter a SYNC that is a period late may be the next one on
a late host. The proof comes by itself: a host that was late takes all that waits in one go. If none was
missing, the SYNCs that follow are there in that burst, until none is due any more: confirmed as they were
counted. If the host waits again (PACED SYNCs, each more than half a period after the one before) and SYNCs
are still behind, these are lost. A first one that is behind by whole periods leaves the place of the loss
clear. Where it is not whole, or where the number changes, some came late and others are missing: doubt. So it
is where SYNCs would then have come sooner than any did: a host that is always late makes these, too.

**The instant.** An interface samples at the SYNC, or by a timer that follows it; which, it does not say. So
a SYNC off its grid (without receive times: sooner than any) puts the instant of its sample in doubt by as
much, and one whose grid has moved for good that of all samples from then on: the position is in doubt by the
speed times that, and is flagged, or lost, by arithmetic. The usual jitter is not part of it: it does not hit
whole cycles again and again, and the residuals show it (docs/time.md). A step of the grid within the jitter
shows in the mean of many SYNCs, and is the same doubt then (deviations.py).

**Extra SYNCs** (sent twice, or of another producer) are none for sampling, but they are for CANopen: every
SYNC on the bus triggers the synchronous PDOs. Only one that is repeated by its counter is none at all.
RELOCK SYNCs in a row that are extra or off, and regular on a line of their own, are another rate or phase:
the clock is set again. So are as many intervals that are all longer by the same, and by no counter: a slower
rate, or the usual one again after extra SYNCs in the middle were taken for one. No host makes these: one that
is late by a period finds the next SYNC, too.

| bound | value | reason |
|---|---|---|
| LEAST_EARLY | 0.15 period | a SYNC waits for 135 us at 1 Mbit/s: those after it come sooner by that |
| WHOLE | 0.85 period | a SYNC this long after another is no repetition: the same jitter |
| LONGER | 1.25 period | RELOCK such intervals are longer by more than the period that a host can be late |
| PACED | 2 SYNCs | a host is interrupted while it takes what waits, but not twice, a period apart |
| MOST_OPTIONS | 4 | more intervals are more machines than phases tell apart |
| UNSETTLED_S | 0.5 s | taken for a period where none is known |
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from math import inf, isfinite
from typing import NamedTuple

from canfb.timing.answer_delay import SOONEST, AnswerDelay
from canfb.timing.since_sample import MOST_INTERVALS, SinceSample
from canfb.timing.sync_clock import EARLIEST, LEAST_PERIOD_S, SAME_PERIOD, SyncClock, is_regular
from canfb.timing.sync_verdict import EXTRA, NOTHING_TO_REPORT, REPEATED, SyncVerdict

LEAST_EARLY = 0.15
WHOLE = 0.85
LONGER = 1.25
HALF = 0.5
PACED = 2
RELOCK = 6
MOST_OPTIONS = 4
UNSETTLED_S = 0.5
ROUNDING = 1e-6  # of the period: a PDO in the same call as its SYNC is not early by that


class Zone(IntEnum):
    """Where a SYNC falls."""

    EARLY, ON, OFF, BEHIND, AGAINST = range(5)


class _Sync(NamedTuple):
    """One SYNC as it is judged, in periods."""

    time_s: float
    stamped: bool
    counter: int | None
    apart: float  # from the last one that was received
    lost: int  # before it, as counted
    off: float  # from when it was due
    behind: int  # more that may be missing

    @property
    def is_between(self) -> bool:
        """If so many are missing, it is earlier than the earliest: rather it is late."""
        return self.off < self.behind - LEAST_EARLY


class SyncJudge:
    """Judges SYNCs by their times, seconds, any numbers; ``stamped`` says that the bus gave the time.

    ``until`` is the time after which the position is not valid without another SYNC (where there is none,
    another sample), inf while nothing is expected. ``synced_s`` is when the last SYNC was received. ``delay``
    is that of the samples that answer; without samples there is none.
    """

    # More than 30 attributes in a dict cost each frame 3 % of a cycle.
    __slots__ = (
        "_assumed",
        "_counter",
        "_debt",
        "_delay",
        "_gap",
        "_high_s",
        "_low_s",
        "_next_counter",
        "_offered",
        "_paced",
        "_received_s",
        "_set",
        "_soon",
        "_spare_s",
        "_sparse",
        "_streak",
        "_table",
        "_unclear",
        "_uneven",
        "_wait_s",
        "before_s",
        "begun",
        "clock",
        "count",
        "early",
        "extra_after",
        "extra_came",
        "is_open",
        "late_s",
        "on_followed",
        "overflow",
        "periods",
        "stamped",
        "synced_s",
        "until",
    )

    def __init__(self, delay: AnswerDelay | None = None) -> None:
        self.clock = SyncClock()
        self.count = SinceSample()
        """What has passed since the last sample."""
        self._delay = AnswerDelay() if delay is None else delay
        self.overflow = 0
        """SYNC counter overflow (1019h)."""
        self.periods = 2
        """Periods without SYNC until the position is not valid (2010:06)."""
        self.on_followed: Callable[[float, bool], None] | None = None
        """Called as (time_s, stamped) with each usual SYNC at first, then with every TOGETHER-th."""
        self._table: dict[tuple[Zone, bool], Callable[[_Sync], SyncVerdict]] = {
            (Zone.EARLY, False): self._extra,
            (Zone.EARLY, True): self._contradicted,
            (Zone.ON, False): self._on_time,
            (Zone.ON, True): self._all_came,
            (Zone.OFF, False): self._off_grid,
            (Zone.OFF, True): self._off_grid,
            (Zone.BEHIND, False): self._late,
            (Zone.BEHIND, True): self._still_late,
            (Zone.AGAINST, False): self._contradicted,
            (Zone.AGAINST, True): self._contradicted,
        }
        self.pause()

    def pause(self) -> None:
        """The next SYNC begins; the period is kept."""
        self.clock.pause()
        self.until = inf
        self.begun = False
        self.extra_came = False
        """Since the last SYNC: the interface may answer it."""
        self.extra_after = 0.0
        """Periods from the last SYNC to the extra one."""
        self.synced_s = self._received_s = 0.0  # the last one, and the last one with extra ones
        self.before_s = 0.0
        """When the SYNC before the last one was received."""
        self.stamped = False
        """The time of the last SYNC is that at which it was on the bus."""
        self.count.begin()
        self._counter: int | None = None
        self._next_counter: int | None = None
        self._gap = False  # SYNCs were missing, and none was on its grid since
        self._streak: list[float] = []
        self._sparse: list[float] = []  # in a row, each after a longer interval
        self._assumed = 0  # SYNCs after the last one, as if they had been received
        self._uneven = False  # extra SYNCs came, and it may be another rate
        self.late_s = 0.0
        """How late the last SYNC was that opened the question whether others are missing."""
        self._close()
        self._look_ahead()

    def _close(self) -> None:
        """No SYNC may be missing."""
        self.is_open = False
        """SYNCs may be missing: what follows shows it."""
        self._debt = self._paced = 0
        self._set: tuple[float, ...] = ()  # intervals of the first sample that was late
        self._offered = self._unclear = False

    def _look_ahead(self) -> None:
        """Which of the next SYNCs need no judgement."""
        clock, count, period = self.clock, self.count, self.clock.period_s
        # Periods: from `early` on a SYNC is extra, from `_soon` on its instant is in doubt.
        self.early = min(EARLIEST, max(LEAST_EARLY, clock.jitter))
        self._soon = max(LEAST_EARLY, clock.deviations.early)
        self._wait_s = period or UNSETTLED_S
        self._spare_s = clock.jitter * period  # a SYNC is not overdue before that
        self._low_s, self._high_s = inf, -inf
        busy = self.is_open or self._streak or self._gap or self._sparse or count.slack or count.before_open
        if period and not (busy or count.error or count.error_before):
            self._low_s, self._high_s = -min(self.early, self._soon) * period, HALF * period
            if self.stamped:  # the time says both sides
                self._low_s, self._high_s = -clock.jitter * period, clock.jitter * period
            # Where a sample may come less than a period after the last, both are judged (Judge._early_s).
            spare_s = (1.0 / SOONEST - 1.0) * self._delay.low_s
            self._low_s = max(self._low_s, -max(spare_s, ROUNDING * period))

    def sync(self, time_s: float, stamped: bool, counter: int | None) -> SyncVerdict:
        """A SYNC at ``time_s`` with its ``counter``, None without one."""
        clock, count = self.clock, self.count
        error = time_s - clock.due_s
        if (
            self._low_s < error < self._high_s
            and count.answered
            and counter == self._next_counter
            and stamped == self.stamped
        ):
            clock.due_s += clock.period_s
            self.before_s = self.synced_s
            self.synced_s = self._received_s = time_s
            if counter is not None:
                self._counter, self._next_counter = counter, 1 if counter == self.overflow else counter + 1
            self.until = time_s + self.periods * self._wait_s + self._spare_s
            count.answered, count.usual, count.intervals = False, True, 1
            errors = clock.errors
            errors.append(error)
            return self._follow(time_s, stamped) if len(errors) >= clock.together else NOTHING_TO_REPORT
        verdict = self._judged(time_s, stamped, counter)
        self._look_ahead()
        return verdict

    def _follow(self, time_s: float, stamped: bool) -> SyncVerdict:
        self.clock.learn(stamped)
        step = self.clock.step()
        self._look_ahead()
        if self.on_followed is not None:
            self.on_followed(time_s, stamped)
        return SyncVerdict(doubt=step) if step else NOTHING_TO_REPORT

    def _judged(self, time_s: float, stamped: bool, counter: int | None) -> SyncVerdict:
        if not isfinite(time_s):
            return EXTRA
        if not self.begun:
            self.clock.begin(time_s)
            return self._take(_Sync(time_s, stamped, counter, 1.0, 0, 0.0, 0))
        modulus, counted = 1, 0
        if counter is not None and self._counter is not None and self.overflow >= 2:
            modulus, counted = self.overflow, (counter - self._counter - 1) % self.overflow
        if not self.clock.period_s:
            rough = self.clock.rough_s
            if modulus > 1 and counted == modulus - 1 and not time_s - self.synced_s > HALF * rough > 0.0:
                return REPEATED
            verdict = self._take(_Sync(time_s, stamped, counter, 1.0, counted, 0.0, 0))
            self.clock.start(time_s, stamped)
            return verdict
        zone, sync = self._place(time_s, stamped, counter, modulus, counted)
        if zone is Zone.EARLY and modulus > 1:
            self._received_s = time_s
            return REPEATED
        if self._is_sparse(sync, (counted + self._assumed) % modulus):
            self._close()
            return self._set_again(sync, self._sparse)
        return self._table[zone, self.is_open](sync)

    def _is_sparse(self, sync: _Sync, counted: int) -> bool:
        """SYNCs come at a slower rate: all the last ones after longer intervals, which are regular."""
        if sync.apart - counted <= LONGER:
            self._sparse.clear()
            return False
        self._sparse = [*(self._sparse or [self._received_s])[-RELOCK:], sync.time_s]
        return len(self._sparse) > RELOCK and is_regular(self._sparse)

    def _place(
        self, time_s: float, stamped: bool, counter: int | None, modulus: int, counted: int
    ) -> tuple[Zone, _Sync]:
        """The zone of a SYNC, and the SYNCs before it that were not received."""
        clock, period = self.clock, self.clock.period_s
        lag = min((time_s - clock.due_s) / period, float(MOST_INTERVALS))
        apart = (time_s - self._received_s) / period
        early = lag <= -self.early and apart < WHOLE
        if early and counted == modulus - 1:
            return Zone.EARLY, _Sync(time_s, stamped, counter, apart, 0, lag, 0)
        if stamped:
            wraps = round((lag - counted) / modulus)
        else:
            wraps = -1 if counted == modulus - 1 > 0 and lag < counted - HALF else 0
        lost = counted + wraps * modulus
        off = lag - lost
        behind = 0 if stamped else max(0, int((off + self.early) // modulus) * modulus)
        sync = _Sync(time_s, stamped, counter, apart, max(0, lost), off, behind)
        if lost < 0:
            return Zone.EARLY if early and modulus == 1 else Zone.AGAINST, sync
        if off < -HALF or (stamped and off > HALF):
            return Zone.AGAINST, sync
        if behind:
            return Zone.BEHIND, sync
        return Zone.OFF if stamped and abs(off) > clock.jitter else Zone.ON, sync

    def _take(self, sync: _Sync, doubt: float = 0.0, confirmed: float | None = None) -> SyncVerdict:
        """Count this SYNC, and those before it that were not received."""
        clock, lost = self.clock, sync.lost
        missed, shown = self.count.add(lost, sync.behind > 0)
        confirmed = confirmed or shown
        if clock.period_s and self.begun:
            clock.due_s += (1 + lost) * clock.period_s
        self._assumed, self._uneven = 0, False
        self._gap = lost > 0 or (self._gap and abs(sync.off) > clock.jitter)
        self.before_s, self.synced_s, self._received_s = self.synced_s, sync.time_s, sync.time_s
        self._count_from(sync.counter)
        self.stamped, self.begun = sync.stamped, True
        self.extra_came = False
        self.until = sync.time_s + self.periods * self._wait_s + self._spare_s
        if not (missed or doubt or lost) and confirmed is None:
            return NOTHING_TO_REPORT
        return SyncVerdict(missed=missed, lost=lost, confirmed=confirmed, doubt=doubt)

    def _count_from(self, counter: int | None) -> None:
        self._counter = counter
        self._next_counter = counter if counter is None else 1 if counter == self.overflow else counter + 1

    def _on_time(self, sync: _Sync) -> SyncVerdict:
        clock, another_rate = self.clock, False
        if self._streak:
            streak = [*self._streak, sync.time_s]
            another_rate = not sync.stamped and len(streak) > 2 and clock.is_left_by(streak)
            on_grid = abs(sync.apart - 1 - sync.lost) <= clock.jitter and abs(sync.off) <= self.early
            if on_grid and not another_rate:
                self._streak.clear()
            elif self._goes_on(sync.time_s):
                return self._set_again(sync, self._streak)
        verdict = self._take(sync)
        self._uneven = bool(self._streak) and (another_rate or sync.off > self.early)
        if self._streak and sync.stamped:  # one that was expected, by chance: others before it were not
            self.count.error = abs(sync.apart - 1 - sync.lost)
        elif not sync.stamped and sync.off < -self._soon:
            self.count.error = -sync.off
        if not self._streak and (sync.stamped or sync.off < 1.0):
            clock.errors.append(sync.off * clock.period_s)
            if len(clock.errors) >= clock.together:
                doubt = self._follow(sync.time_s, sync.stamped).doubt
                verdict = verdict._replace(doubt=max(verdict.doubt, doubt)) if doubt else verdict
        return verdict

    def _all_came(self, sync: _Sync) -> SyncVerdict:
        """No SYNC is due that was not received: all were late. Not so if the host waited again."""
        modulus = self._turn(sync)
        nearly = int((sync.off + HALF) // modulus) * modulus
        if nearly > 0 and sync.apart > HALF and not sync.stamped:
            return self._still_late(sync._replace(behind=nearly))
        confirmed = self._set[0] if self._offered else None
        self._close()
        return self._take(sync, confirmed=confirmed)

    def _off_grid(self, sync: _Sync) -> SyncVerdict:
        confirmed = self._set[0] if self._offered else None
        self._close()
        if self._goes_on(sync.time_s):
            return self._set_again(sync, self._streak, doubt=abs(sync.off))
        verdict = self._take(sync, confirmed=confirmed)
        self.count.error = abs(sync.off)
        return verdict

    def _extra(self, sync: _Sync) -> SyncVerdict:
        if self._goes_on(sync.time_s):
            return self._set_again(sync, self._streak)
        same = sync.stamped and self.stamped and sync.time_s - self._received_s < LEAST_PERIOD_S
        self._received_s, self.extra_came = sync.time_s, True
        self.extra_after = (sync.time_s - self.synced_s) / self.clock.period_s
        return REPEATED if same else EXTRA

    def _contradicted(self, sync: _Sync) -> SyncVerdict:
        self._close()
        if self._goes_on(sync.time_s):
            return self._set_again(sync, self._streak)
        verdict = self._take(sync, doubt=max(1.0, float(sync.lost)))
        self.clock.due_s = sync.time_s + self.clock.period_s
        return verdict

    def _turn(self, sync: _Sync) -> int:
        """Periods in a turn of its counter."""
        return self.overflow if sync.counter is not None and self.overflow >= 2 else 1

    def _late(self, sync: _Sync) -> SyncVerdict:
        if self._goes_on(sync.time_s):
            return self._set_again(sync, self._streak)
        modulus = self._turn(sync)
        verdict = self._take(sync)
        self.is_open, self._debt, self.late_s = True, sync.behind, sync.off * self.clock.period_s
        first, most = float(max(1, self.count.intervals)), sync.behind // modulus
        uneven = max(sync.off - sync.behind, abs(sync.apart - 1 - sync.lost - sync.behind))
        self._unclear = most + 1 > MOST_OPTIONS or uneven > self.early or sync.is_between
        self._unclear |= self.count.slack > 0  # the last sample may have answered one of these
        self._set = tuple(first + n * modulus for n in range(min(most + 1, MOST_OPTIONS)))
        return verdict

    def _still_late(self, sync: _Sync) -> SyncVerdict:
        if self._goes_on(sync.time_s):
            self._close()
            return self._set_again(sync, self._streak)
        self._unclear |= sync.behind != self._debt or sync.is_between
        self._debt = sync.behind
        self._paced += sync.apart > HALF
        if self._paced < PACED:
            return self._take(sync)
        more, unclear = sync.behind, self._unclear
        confirmed = self._set[0] + more if self._offered and not unclear else None
        doubt = float(more) if unclear and self.count.sampled else 0.0
        self._close()
        if confirmed is None and not doubt:  # no sample has come yet: these are missed like any others
            return self._take(sync._replace(lost=sync.lost + more))
        verdict = self._take(sync, doubt=doubt, confirmed=confirmed)
        self.clock.due_s += more * self.clock.period_s
        return verdict._replace(lost=verdict.lost + more)

    def _goes_on(self, time_s: float) -> bool:
        """SYNCs that are not where they were due, again and again, and regular."""
        streak = self._streak
        streak.append(time_s)
        if len(streak) < RELOCK:
            return False
        if self.clock.is_left_by(streak):
            return True
        del streak[0]
        return False

    def _set_again(self, sync: _Sync, times_s: list[float], doubt: float = 1.0) -> SyncVerdict:
        """Another rate or phase: so many intervals may have passed unnoticed meanwhile."""
        before_s = self.clock.period_s
        verdict = self._take(sync._replace(lost=0))
        self.clock.set_again(times_s)
        self._streak.clear()
        self._sparse.clear()
        changed = abs(self.clock.period_s - before_s) > SAME_PERIOD * before_s
        return verdict._replace(doubt=max(1.0, self.clock.period_s / before_s) if changed else doubt)

    def advance(self, intervals: int) -> None:
        """So many SYNCs came since the last one, and were not received."""
        clock = self.clock
        self.count.pass_by(intervals)
        self._assumed += intervals
        self.synced_s += intervals * clock.period_s
        clock.due_s += intervals * clock.period_s
        self.stamped = False
        self._close()
        if self._counter is not None and self.overflow > 1:
            self._count_from((self._counter - 1 + intervals) % self.overflow + 1)
        self.until = self.synced_s + self.periods * self._wait_s + self._spare_s
        self._look_ahead()

    # What its sample needs.

    def settle(self, options: tuple[float, ...], certain: bool) -> tuple[tuple[float, ...], bool]:
        """The intervals of a sample, and whether they are ``certain``, with what is open about its SYNC."""
        certain = certain and not self._uneven
        if not self.is_open:
            return options, certain
        certain = certain and not (self._offered or self._unclear)
        if not self._offered and len(options) == 1:
            options = self._set
        self._offered = True
        return options, certain

    def sample_came(self, was_answered: bool) -> None:
        """A sample that was not usual; ``was_answered``: another one came for the last SYNC before it."""
        if was_answered:  # an interval without a SYNC that was received
            self._sparse.clear()
        if self._high_s == -inf or self.count.slack or self.count.error_before:
            self._look_ahead()

    def give_up(self) -> None:
        """The last SYNC has no sample, which was reported already."""
        self.count.answered, self.count.usual = True, False
        self._high_s = -inf  # the next SYNC adds to the intervals since the last sample

    def overdue(self, now: float) -> int:
        """Samples that are missing by ``now``, without a SYNC or a sample; they count as missed from here on.

        0 where the period is not known, or no sample has come yet: then only the deadline has passed.
        """
        period = self.clock.period_s
        if not period or not self.begun or not isfinite(now):
            self.until = inf
            return 0
        passed = max(1, min(int((now - self.synced_s) / period + 1e-6) - 1, MOST_INTERVALS))
        missed = passed + (not self.count.answered)
        self.advance(passed)
        self.count.before_open = True
        self.give_up()
        self.until = max(self.synced_s + 2.0 * period, now + period)  # after more than MOST_INTERVALS
        return missed if self.count.sampled else 0
