"""SYNCs on their grid: how many intervals have passed, which SYNCs are missing, which one is off its place.

With receive times, a SYNC is on the grid (:mod:`canfb.timing.grid`) or off it (docs/time.md). Without them,
the call is an upper bound of the instant: SYNCs are counted in their order, by their counter if they have
one, and the line is fitted to the earliest of TOGETHER calls. Before a SYNC that is late by a period (with a
counter: by a turn of it) others may have been lost: no position is valid until a SYNC is in time again. If
all stay late, SYNCs were lost. Doubt about a position is speed times intervals: zero at standstill.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, isfinite
from typing import NamedTuple

from canfb.timing.grid import Grid

USUAL_JITTER_S = 0.2e-3  # 135 us for a frame before it at 1 Mbit/s, 65 us of producer and receive time
SAME_FRAME_S = 47e-6  # the shortest frame at 1 Mbit/s: a second SYNC cannot be sooner
TOGETHER = 8  # calls, the earliest of which the line is fitted to
HALF = 0.5
LATE = 0.9  # periods of lateness, with a counter beyond turn - 1, from which on SYNCs before may be lost
EARLY = 0.2  # periods: the line follows the earliest of eight calls, which may be late itself
FASTER = 0.75  # periods: without receive times, a SYNC sooner after another one is an extra one
MOST_INTERVALS = 1 << 20
UNSETTLED_S = 0.5  # used for the period while it is not known


class SyncVerdict(NamedTuple):
    """What a SYNC shows.

    lost      number of SYNCs before it that were not received
    extra     it has no sample; ``repeated``: it is a copy of the last one, to be ignored
    off       distance from its place, intervals; 0.0: on the grid, and so were those before
    doubt     number of intervals that may have passed unnoticed
    """

    lost: int = 0
    extra: bool = False
    repeated: bool = False
    off: float = 0.0
    doubt: float = 0.0


USUAL = SyncVerdict()  # by identity: in time, in turn, in no need of judgement
ON_TIME = SyncVerdict()  # equal to USUAL, after a judgement
EXTRA = SyncVerdict(extra=True)
REPEATED = SyncVerdict(extra=True, repeated=True)
# The verdict; places from the last SYNC for the fit of the line, 0: not fitted; distance from the place, s.
Judged = tuple[SyncVerdict, int, float]


class Syncs:
    """Give each SYNC to :meth:`sync`: its time, seconds, any float; ``stamped`` if it is a receive time.

    ``place`` counts SYNCs, received or not; ``synced_s`` is the time of the last one. Without another SYNC
    the position is valid up to ``until``, inf while none is expected.
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
        self.overflow = 0  # synchronous counter overflow value (1019h)
        self._periods = 2
        # Called as (time_s, stamped) with every TOGETHER-th usual SYNC.
        self.on_followed: Callable[[float, bool], None] | None = None
        # The period by sample times or 1006h, for calls before the first line; 0.0: not known.
        self.expected_s: Callable[[], float] = lambda: 0.0
        self.place = 0
        self.pause()

    def declare(self, jitter_s: float, periods: int = 2) -> None:
        self._periods = periods
        self.grid.declare(jitter_s or USUAL_JITTER_S)
        self._low_s, self._high_s = inf, -inf

    def forget(self) -> None:
        """Forget phase and period: another producer may send SYNC from now on."""
        self.grid.forget()
        self.pause()

    def pause(self) -> None:
        """Keep the period; the next SYNC gives the phase."""
        self.grid.pause()
        self.until = inf
        self.begun = self.stamped = False
        self.extra_came = False  # an extra SYNC came since the last one: the interface may answer it
        self.extra_after = 0.0  # periods from the last SYNC to the extra one
        # Lateness of the last SYNC, without receive time, if others may be lost before it; 0.0: in time.
        self.late_s = 0.0
        self.synced_s = self._received_s = 0.0  # time of the last SYNC; the same counting extra ones
        self._next_counter: int | None = None  # None: the last SYNC had no counter
        self._grouped, self._earliest_s = 0, inf  # SYNCs of this group; the least distance from their places
        self._valid_s = inf  # from a SYNC to `until`
        self._low_s, self._high_s = inf, -inf  # distance from its place of a SYNC that needs no judgement
        self._assumed = False  # the last place was passed without its SYNC
        # The same by time-out, with sample times: the next SYNC may have another rate.
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
        # With 2010:06 = 1 the next SYNC may be late by its jitter.
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
            lost, expected_s = missing or 0, self.expected_s()
            # The median of calls may be that of a late host, which alone says nothing.
            period_s = grid.rough if stamped else expected_s and max(grid.rough, expected_s)
            places, most = apart_s / (period_s or inf), (lost + 1) * (1.0 + (HALF if stamped else LATE))
            grid.learn(time_s) if stamped else grid.learn_earliest(time_s, expected_s)
            return self._taken(stamped, lost, doubt=places if places > most else 0.0)
        return (self._by_time if stamped else self._by_order)(time_s, missing)

    def _missing(self, counter: int | None) -> int | None:
        """SYNCs missing before this one by the counter, modulo its turn; None: not known."""
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
            if not on and doubt <= 1.0:  # between two places: the counter decides
                if counted < 1:
                    return self._extra(time_s)
                places, doubt = counted, 0.0
            grid.skip(places)
            return self._taken(True, max(0, min(places, counted) - 1), abs(off_s) / grid.period, doubt)
        # A line through a few instants with jitter may be wrong by a place.
        doubt = float(missing is None and not grid.locked and (places > 1 or not on))
        # In a row of instants off the grid, one of a producer at another rate may hit a place by chance.
        verdict, _, _ = self._taken(True, places - 1, abs(off_s) / grid.period if grid.row else 0.0, doubt)
        if not on:
            grid.skip(places)
        return verdict, places if on else 0, off_s

    def _extra(self, time_s: float) -> Judged:
        self._received_s, self.extra_came = time_s, True
        self.extra_after = abs(time_s - self.synced_s) / self.grid.period
        # Doubt: it may be the SYNC of the assumed place, or the next SYNC, with a line that is not exact yet.
        return EXTRA._replace(doubt=float(self._assumed or not (self.stamped and self.grid.locked))), 0, 0.0

    def _set_again(self, places: int, off_s: float) -> Judged:
        grid, before_s = self.grid, self.grid.period
        changed = grid.set_again(grid.row)
        doubt = max(1.0, grid.period / before_s) if changed else abs(off_s) / before_s
        self.late_s = 0.0
        self._grouped, self._earliest_s = 0, inf
        return self._taken(self.stamped, 0 if changed else max(0, places - 1), doubt=doubt)

    # Without receive times.

    def _by_order(self, time_s: float, missing: int | None) -> Judged:
        grid, lost = self.grid, missing or 0
        turn = self.overflow if missing is not None else 1
        late_s = time_s - grid.due - lost * grid.period
        most = turn - 1 + (HALF if self.late_s or self.extra_came else LATE)
        early, late = late_s < self._early_s(missing is not None), late_s > most * grid.period
        if early and self._assumed and missing == turn - 1:  # the SYNC of the assumed place, late
            self.place -= 1
            grid.skip(-1)
            return self._by_order(time_s, 0)
        if early and missing:
            # By its counter it is due much later: the counter jumped, or is that of another producer.
            doubt, lost, late_s = float(lost), 0, time_s - grid.due
        else:  # the line predicts as many places as it was fitted to: TOGETHER for each call seen
            ahead = late_s / (TOGETHER * grid.seen * grid.period)
            doubt = ahead if missing is None and ahead > 1.0 else 0.0
        in_time = not (early or late or self.extra_came or self._was_overdue)
        if in_time and not doubt:
            grid.is_in_turn(time_s, may_be_late=True)
        elif grid.refuse_call(time_s, early, self.expected_s()):
            behind = round(late_s / grid.period / turn) * turn
            verdict, _, _ = self._set_again(1 + behind, late_s)
            return verdict._replace(doubt=max(1.0, verdict.doubt)), 0, 0.0
        if early and missing is None and time_s - self._received_s < FASTER * grid.period:
            return self._extra(time_s)
        if not late and self.late_s and late_s < HALF * grid.period:
            self.late_s = 0.0  # in time again: none was lost
        elif late or self.late_s:
            self.late_s = max(late_s, grid.period * 1e-9)
        verdict, _, _ = self._taken(False, lost, -late_s / grid.period if early else 0.0, doubt)
        if in_time and late_s < LATE * grid.period:  # the call of a late host does not show the grid
            return verdict, 1 + lost, late_s
        grid.skip(1 + lost)
        return verdict, 0, 0.0

    def _early_s(self, counted: bool) -> float:
        """Distance from its place, s, below which a SYNC is early; ``counted``: it has a counter."""
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
        """``until`` passed without a SYNC: pass the places before ``now``. False if the period is not known.

        ``timed``: samples bring their time.
        """
        period_s = self.grid.period
        if not period_s or not self.begun or not isfinite(now):
            self.until = inf
            return False
        self.advance(max(1, min(int((now - self.synced_s) / period_s + 1e-6) - 1, MOST_INTERVALS)))
        self._was_overdue = timed
        self.until = max(self.synced_s + 2.0 * period_s, now + period_s)
        return True
