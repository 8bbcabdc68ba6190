"""SYNCs on their grid: how many intervals have passed, which samples are missing, which instant is bad.

With receive times a SYNC lies on the grid (:mod:`canfb.timing.grid`), or off it (docs/time.md). Without them
the call is only the latest time of the frame: SYNCs are counted in their order, with their counter where they
have one, and the line follows the earliest of TOGETHER calls. One that is late by a turn of its counter,
without one by a period, may come after others that were lost: nothing is valid until one is in time again.
Those that stay late show that SYNCs are missing. Doubt is speed times intervals: at standstill it is zero.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, isfinite
from typing import NamedTuple

from canfb.timing.grid import Grid

USUAL_JITTER_S = 0.2e-3  # a frame before it at 1 Mbit/s, and 65 us of producer and receive time
SAME_FRAME_S = 47e-6  # the shortest frame at 1 Mbit/s: no SYNC comes sooner after another
TOGETHER = 8
HALF = 0.5
LATE = 0.9  # of a turn
EARLY = 0.2  # of a period: the line follows the earliest of eight calls, which may be late, too
FASTER = 0.75  # of a period: without receive times, early SYNCs of another rate
MOST_INTERVALS = 1 << 20
UNSETTLED_S = 0.5  # taken for a period where none is known


class SyncVerdict(NamedTuple):
    """What a SYNC shows.

    lost      SYNCs before it that were not received
    extra     no sample is to be expected for it; ``repeated``: nothing is to be done with it
    off       how far its instant is off its place, intervals; 0.0: on the grid, and nothing is open
    doubt     intervals that may have passed unnoticed; 0.0: none
    """

    lost: int = 0
    extra: bool = False
    repeated: bool = False
    off: float = 0.0
    doubt: float = 0.0


USUAL = SyncVerdict()  # On time, in turn after another, and nothing is open.
ON_TIME = SyncVerdict()
EXTRA = SyncVerdict(extra=True)
REPEATED = SyncVerdict(extra=True, repeated=True)
# With it the places by which the line goes on, 0: not by this SYNC, and how far off it is, seconds.
Judged = tuple[SyncVerdict, int, float]


class Syncs:
    """Give each SYNC to :meth:`sync`: its time in seconds, any number, and whether the bus gave it.

    ``place`` counts SYNCs, received or not; ``synced_s`` is when the last one was received. ``until`` is the
    time after which the position is not valid without another SYNC, inf while nothing is expected.
    """

    __slots__ = (
        "_assumed",
        "_earliest_s",
        "_grouped",
        "_high_s",
        "_low_s",
        "_next_counter",
        "_periods",
        "_received_s",
        "_valid_s",
        "_was_overdue",
        "begun",
        "expected_s",
        "extra_after",
        "extra_came",
        "grid",
        "late_s",
        "on_followed",
        "overflow",
        "place",
        "stamped",
        "synced_s",
        "until",
    )

    def __init__(self) -> None:
        self.grid = Grid(jitter=USUAL_JITTER_S)
        self.overflow = 0  # SYNC counter overflow (1019h).
        self._periods = 2
        # Called as (time_s, stamped) with every TOGETHER-th usual SYNC.
        self.on_followed: Callable[[float, bool], None] | None = None
        # The period that others say, while none is known; 0.0: nobody does.
        self.expected_s: Callable[[], float] = lambda: 0.0
        self.place = 0
        self.pause()

    def declare(self, jitter_s: float, periods: int = 2) -> None:
        self._periods = periods
        self.grid.declare(jitter_s or USUAL_JITTER_S)
        self._low_s, self._high_s = inf, -inf

    def forget(self) -> None:
        """Another producer may send SYNC from now on."""
        self.grid.forget()
        self.pause()

    def pause(self) -> None:
        """The next SYNC begins; the period is kept."""
        self.grid.pause()
        self.until = inf
        self.begun = self.stamped = False
        self.extra_came = False  # Since the last SYNC: the interface may answer it.
        self.extra_after = 0.0  # Periods from the last SYNC to the extra one.
        # So late is a SYNC without receive time that others may be lost before it; 0.0: it is in time.
        self.late_s = 0.0
        self.synced_s = self._received_s = 0.0  # the last one, and with extra ones
        self._next_counter: int | None = None  # None: the last SYNC had none
        self._grouped, self._earliest_s = 0, inf
        self._valid_s = inf  # from a SYNC to `until`
        self._low_s, self._high_s = inf, -inf  # off the place, of a SYNC that needs no judgement
        self._assumed = False  # the last place was never received: its PDO came
        # Nor did that come: where samples are timed the next SYNC may be of another rate.
        self._was_overdue = False

    def sync(self, time_s: float, stamped: bool, counter: int | None) -> SyncVerdict:
        grid = self.grid
        off_s, places, verdict = time_s - grid.due, 1, USUAL
        if not (
            self._low_s < off_s < self._high_s and counter == self._next_counter and stamped == self.stamped
        ):
            verdict, places, off_s = self._judged(time_s, stamped, counter)
            if verdict.extra:
                self._look_ahead()
                return verdict
            self._next_counter = counter
        self.place += 1
        self.synced_s = self._received_s = time_s
        if counter is not None:
            self._next_counter = 1 if counter == self.overflow else counter + 1
        if places:
            self._grouped += 1
            if stamped:
                grid.follow(places, off_s)
            else:
                grid.due += places * grid.period
                grid.lead = 0.0
                if off_s < self._earliest_s:
                    self._earliest_s = off_s
            if self._grouped >= TOGETHER:
                self._group_over()
        if verdict is not USUAL:
            self._look_ahead()
        self.until = time_s + self._valid_s
        return verdict

    def _group_over(self) -> None:
        grid = self.grid
        if not self.stamped:
            grid.skip(-1)
            grid.follow(1, self._earliest_s, TOGETHER)
        self._grouped, self._earliest_s = 0, inf
        self._look_ahead()
        if self.on_followed is not None:
            self.on_followed(self.synced_s, self.stamped)

    def _look_ahead(self) -> None:
        grid = self.grid
        self._low_s, self._high_s = inf, -inf
        counted = self._next_counter is not None and self.overflow > 1
        # With one period alone, the next may be late.
        late_s = grid.allowed if self._periods == 1 else 0.0
        self._valid_s = self._periods * (grid.period or UNSETTLED_S) + late_s
        if grid.period and not (self.late_s or grid.row or self.extra_came):
            self._low_s = -grid.allowed if self.stamped else self._early_s(counted)
            self._high_s = grid.allowed if self.stamped else LATE * grid.period

    def _judged(self, time_s: float, stamped: bool, counter: int | None) -> Judged:
        grid = self.grid
        if not isfinite(time_s):
            return EXTRA, 0, 0.0
        missing = self._missing(counter)
        if not self.begun:
            grid.begin(time_s)
            return self._taken(stamped, 0)
        apart_s = time_s - self._received_s
        again = missing is not None and missing == self.overflow - 1 > 0
        if apart_s < (HALF * (grid.rough or inf) if again else SAME_FRAME_S if stamped else 0.0):
            return REPEATED, 0, 0.0
        if not grid.period:
            places = apart_s / (grid.rough or inf) if stamped and missing is None else 1.0
            grid.learn(time_s) if stamped else grid.learn_earliest(time_s, self.expected_s())
            return self._taken(stamped, missing or 0, doubt=places if places > 1.0 + HALF else 0.0)
        return (self._by_time if stamped else self._by_order)(time_s, missing)

    def _missing(self, counter: int | None) -> int | None:
        """SYNCs before this one by the counter, modulo its turn; None: nothing is known."""
        if counter is None or self._next_counter is None or self.overflow < 2:
            return None
        return (counter - self._next_counter) % self.overflow

    def _taken(self, stamped: bool, lost: int, off: float = 0.0, doubt: float = 0.0) -> Judged:
        self.stamped, self.begun, self.extra_came = stamped, True, False
        self._assumed = self._was_overdue = False
        self.place += lost
        return SyncVerdict(lost, off=off, doubt=doubt) if lost or off or doubt else ON_TIME, 0, 0.0

    # With receive times.

    def _by_time(self, time_s: float, missing: int | None) -> Judged:
        grid = self.grid
        places, off_s = grid.nearest(time_s)
        places = min(places, MOST_INTERVALS)
        contradicts = missing is not None and (places - 1 - missing) % self.overflow != 0
        on = abs(off_s) <= grid.allowed
        in_turn = on and not (contradicts or self.extra_came or self._was_overdue)
        if in_turn and (places == 1 or (places > 1 and missing is not None)):
            grid.is_in_turn(time_s)
        elif grid.refuse(time_s):
            return self._set_again(places, off_s)
        if places < 1:
            return self._extra(time_s)
        if contradicts and missing is not None:
            counted = missing + self.overflow * round((places - 1 - missing) / self.overflow) + 1
            doubt = float(abs(counted - places))
            if not on and doubt <= 1.0:  # between two places the counter says which
                if counted < 1:
                    return self._extra(time_s)
                places, doubt = counted, 0.0
            grid.skip(places)
            return self._taken(True, max(0, min(places, counted) - 1), abs(off_s) / grid.period, doubt)
        # A line through a few instants that jitter may be off by a place.
        doubt = float(missing is None and not grid.locked and (places > 1 or not on))
        # After one that was not in turn, a place may be hit by chance: by a producer at another rate.
        verdict, _, _ = self._taken(True, places - 1, abs(off_s) / grid.period if grid.row else 0.0, doubt)
        if not on:
            grid.skip(places)
        return verdict, places if on else 0, off_s

    def _extra(self, time_s: float) -> Judged:
        self._received_s, self.extra_came = time_s, True
        self.extra_after = abs(time_s - self.synced_s) / self.grid.period
        # Its answer came before it; or it is the next one, and the line is late.
        return EXTRA._replace(doubt=float(self._assumed or not (self.stamped and self.grid.locked))), 0, 0.0

    def _set_again(self, places: int, off_s: float) -> Judged:
        grid, before_s = self.grid, self.grid.period
        changed = grid.set_again(grid.row)
        doubt = max(1.0, grid.period / before_s) if changed else abs(off_s) / before_s
        self.late_s = 0.0
        self._grouped, self._earliest_s = 0, inf
        return self._taken(self.stamped, 0 if changed else max(0, places - 1), doubt=doubt)

    # Without.

    def _by_order(self, time_s: float, missing: int | None) -> Judged:
        grid, lost = self.grid, missing or 0
        turn = self.overflow if missing is not None else 1
        late_s = time_s - grid.due - lost * grid.period
        most = turn - 1 + (HALF if self.late_s or self.extra_came else LATE)
        early, late = late_s < self._early_s(missing is not None), late_s > most * grid.period
        if early and self._assumed and missing == turn - 1:  # it was overdue, and comes: the place is its own
            self.place -= 1
            grid.skip(-1)
            return self._by_order(time_s, 0)
        if early and missing:
            # It was due much later: a counter that jumped, or one of another producer.
            doubt, lost, late_s = float(lost), 0, time_s - grid.due
        else:  # the line is good for as many places ahead as it was learned from
            ahead = late_s / (TOGETHER * grid.seen * grid.period)
            doubt = ahead if missing is None and ahead > 1.0 else 0.0
        in_time = not (early or late or self.extra_came or self._was_overdue)
        if in_time and not doubt:
            grid.is_in_turn(time_s, may_be_late=True)
        elif grid.refuse_call(time_s, early, self.expected_s()):
            return self._relocked(late_s, turn)
        if early and missing is None and time_s - self._received_s < FASTER * grid.period:
            return self._extra(time_s)
        if not late and self.late_s and late_s < HALF * grid.period:
            self.late_s = 0.0  # all came
        elif late or self.late_s:
            self.late_s = max(late_s, grid.period * 1e-9)
        verdict, _, _ = self._taken(False, lost, -late_s / grid.period if early else 0.0, doubt)
        if in_time and late_s < LATE * grid.period:  # a host that is late says nothing of the grid
            return verdict, 1 + lost, late_s
        grid.skip(1 + lost)
        return verdict, 0, 0.0

    def _relocked(self, late_s: float, turn: int) -> Judged:
        behind = round(late_s / self.grid.period / turn) * turn
        verdict, _, _ = self._set_again(1 + behind, late_s)
        return verdict._replace(doubt=max(1.0, verdict.doubt)), 0, 0.0

    def _early_s(self, counted: bool) -> float:
        """Off its place, of a SYNC that is early: as no counter says that it is the next one."""
        period_s = self.grid.period
        return -HALF * period_s if counted else -max(self.grid.allowed, EARLY * period_s)

    # Silence.

    def advance(self, intervals: int) -> None:
        grid = self.grid
        self.place += intervals
        self._assumed = True
        self._low_s, self._high_s = inf, -inf
        self.synced_s += intervals * grid.period
        grid.skip(intervals)
        if self._next_counter is not None and self.overflow > 1:
            self._next_counter = (self._next_counter - 1 + intervals) % self.overflow + 1
        self.until = self.synced_s + self._valid_s

    def overdue(self, now: float, timed: bool = False) -> bool:
        """No SYNC for so long; the places up to ``now`` passed. False where the period is not known."""
        period_s = self.grid.period
        if not period_s or not self.begun or not isfinite(now):
            self.until = inf
            return False
        self.advance(max(1, min(int((now - self.synced_s) / period_s + 1e-6) - 1, MOST_INTERVALS)))
        self._was_overdue = timed
        self.until = max(self.synced_s + 2.0 * period_s, now + period_s)
        return True
