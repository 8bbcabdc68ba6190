"""Sample times of the encoder interface (2000:05): how many sampling intervals lie between two samples.

The interface's own clock measures it exactly: only ratios of differences enter eq. 9, so neither its drift
nor the length of the interval matters. A time is right

- with receive times, if it differs from the last time as its SYNC does from the last SYNC; or if it is at
  its place, and the times so far are closer to their line than to SYNC: the interface samples by a timer;
- with receive times worse than HEARD_S, if those of SYNC and sample both agree; or if it is at the place
  that the count of SYNCs gives, and one of them agrees, or the line of a timer;
- without receive times, if it is at the place that the count gives, or two calls in a row agree.

The line through the right times (:mod:`canfb.timing.grid`) is the one estimate of that clock.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf

from canfb.signal.bounded_motion import HOLE_INTERVALS
from canfb.signal.sample import TICK_S, TICKS
from canfb.signal.speeds import SLIP_CYCLES
from canfb.timing.grid import SHOWN, UNDECLARED, Grid

HALF_TICKS = TICKS // 2
OLDEST = 64.0  # intervals: a time no further back is that of an earlier sample
CLOSEST = 0.25  # intervals: samples closer together would give a poor speed
RECEIVED_S = 10e-6 / 3  # mean error of the interval between two receive times that are exact to 10 us
HEARD_S = 75e-6  # largest error of that interval: 30 us for each of them, 15 us for the interface
FAR_S = 10 * HEARD_S  # largest error in the mean, once there is a line: ROW wrong times do not reach HEARD_S
DRIFT = 2e-4  # of two clocks, 100 ppm each
SAME_PACE = 0.002  # relative change of the interval that is ignored; limits of acceleration use its square
REPEATED, SUSPECT, RESTARTED, CROWDED = -1.0, -2.0, -3.0, -4.0  # see SampleTimes.elapsed


class SampleTimes:
    """Turns sample times into elapsed intervals, and judges them.

    ``sync_interval_s`` is the nominal interval of SYNC, seconds, set if there are several samples in one.
    0.0: the period of ``grid`` is used.
    """

    __slots__ = (
        "_agrees",
        "_at",
        "_at_count",
        "_heard_s",
        "_last",
        "_least_s",
        "_pace_s",
        "_received_s",
        "_refused_counted",
        "_rests",
        "_right_heard_s",
        "_synced_s",
        "grid",
        "off",
        "passed",
        "sync_interval_s",
        "waited",
    )

    def __init__(self, rests: Callable[[], bool] = lambda: False) -> None:
        self._rests = rests  # True: the machine certainly stands still
        self.sync_interval_s = 0.0
        self.grid = Grid()  # the times that were right, ticks since the first one
        # By the newest time: intervals since the last sample; distance of a SUSPECT one from its place.
        self.passed, self.off = 1.0, 0.0
        self.reset()

    def reset(self) -> None:
        self._pace_s = 0.0  # the measured interval, used while sync_interval_s is 0.0
        # Mean error of sample times against receive times of SYNC; and that up to the last right time.
        self._heard_s = self._right_heard_s = 0.0
        self.grid.forget()
        self.forget()

    def forget(self) -> None:
        self.grid.pause()
        self._last: int | None = None
        self._at = 0  # ticks of the last sample that was taken, as the grid has them
        self._received_s: float | None = None  # receive time of that sample
        self._synced_s: float | None = None  # receive time of its SYNC
        # The latest possible time of the host at tick 0: a sample is never after the call of its SYNC.
        self._least_s = inf
        self._at_count = True  # the last right time was at the place that the count gives
        self._agrees = False  # the last refused time agreed with the call of its SYNC
        self._refused_counted = 0.0  # `counted` at the last refused time; 0.0: none since a right one
        self.waited = 0.0  # intervals that passed without a timed sample since the last one

    @property
    def unit_s(self) -> float:
        """The interval in which elapsed times are given, seconds; 0.0 before it is known."""
        return self.sync_interval_s or self._pace_s

    def in_turn(self, time_100ns: int, received_s: float | None, synced_s: float | None) -> float:
        """:meth:`elapsed` for the next sample in turn, if there is no need to look closely; else 0.0."""
        last, grid, unit = self._last, self.grid, self._pace_s
        if last is None or self.waited or self.sync_interval_s or not grid.period or grid.row:
            return 0.0
        ticks = time_100ns - last
        at, allowed, pace_s = self._at + ticks, grid.allowed, grid.period * TICK_S
        off, passed_s = at - grid.due, ticks * TICK_S
        at_place = -allowed <= off <= allowed and CLOSEST * unit <= passed_s <= HOLE_INTERVALS * unit
        if not at_place or abs(pace_s - unit) > SAME_PACE * pace_s:
            return 0.0
        if received_s is None:
            if synced_s is not None:
                soonest_s, least_s = synced_s - at * TICK_S, self._least_s
                if not soonest_s - least_s >= -HEARD_S:
                    return 0.0
                if soonest_s < least_s + HEARD_S:
                    self._least_s = min(soonest_s, least_s + DRIFT * passed_s)
        elif synced_s is None or self._synced_s is None:
            return 0.0
        else:
            error_s = abs(synced_s - self._synced_s - passed_s)
            if error_s > HEARD_S or self._heard_s > HEARD_S:
                return 0.0
            self._heard_s += (error_s - self._heard_s) / SHOWN
        grid.follow(1, off)
        self._take(time_100ns, ticks, received_s, synced_s)
        return passed_s / unit

    def elapsed(
        self,
        time_100ns: int,
        counted: float,
        received_s: float | None = None,
        synced_s: float | None = None,
        speed_cycles: float = 0.0,
    ) -> float:
        """Intervals since the last sample that was taken, above 0; or what is wrong with this time.

        ``counted`` intervals have passed by the count of SYNCs; ``received_s`` and ``synced_s`` are the
        receive times of the sample and its SYNC, seconds, None: not known. A time off its place within the
        interval is right if that costs less than SLIP_CYCLES at ``speed_cycles`` per interval.

        REPEATED: the time of an earlier sample. SUSPECT: fits nothing, by :attr:`off`. CROWDED: a new sample,
        too near to the last one for a speed. RESTARTED: the clock was restarted, or SYNC is on another grid.
        """
        last, grid = self._last, self.grid
        if last is None:
            grid.begin(0.0)
            self._take(time_100ns, 0, received_s, synced_s)
            return counted
        ticks = (time_100ns - last + HALF_TICKS) % TICKS - HALF_TICKS
        self.passed = 0.0
        if not ticks or not self._follow_pace(ticks, counted):
            return REPEATED
        unit = self.unit_s
        self.passed = intervals = ticks * TICK_S / unit
        self.off = abs(intervals - counted)
        if intervals < CLOSEST:
            kind = CROWDED if ticks > 0 else REPEATED if intervals >= -OLDEST else SUSPECT
            return self._refused(time_100ns, ticks, counted, kind, received_s, synced_s)
        passed_s, unsure_s = ticks * TICK_S, UNDECLARED * unit
        apart_s, heard_apart_s = _apart_s(self._synced_s, synced_s), _apart_s(self._received_s, received_s)
        by_count = round(intervals), (intervals - counted) * unit / TICK_S
        places, off = grid.nearest(self._at + ticks) if grid.period else by_count
        off_s = abs(off) * TICK_S
        harmless_s = min(unsure_s, SLIP_CYCLES * unit / speed_cycles) if speed_cycles else unsure_s
        spare_s, most_s = max(HEARD_S, harmless_s), 2.0 * max(grid.allowed * TICK_S, unsure_s)
        error_s = 0.0
        if not self._refused_counted:
            self._right_heard_s = self._heard_s
        if heard_apart_s is not None and apart_s is not None:
            error_s = abs(apart_s - passed_s)
            self.off = max(self.off, error_s / unit, abs(apart_s / unit - counted))
            self._heard_s += (min(error_s, FAR_S if grid.period else unit) - self._heard_s) / SHOWN
        # Times of a timer, or of a clock that each SYNC advances, are closer to the line than to SYNC.
        is_timer = off_s <= spare_s and max(grid.deviation * TICK_S, RECEIVED_S) < self._right_heard_s
        # No time at its place is wrong by most_s: then SYNC was late, and its count says more.
        if heard_apart_s is None or self._heard_s > HEARD_S or error_s >= most_s:
            right = places == round(counted)
            if synced_s is not None and received_s is None:
                soonest_s, least_s = synced_s - (self._at + ticks) * TICK_S, self._least_s
                late_s = soonest_s - least_s
                if right and harmless_s < unsure_s and spare_s < -late_s < inf:
                    right = False
                elif right:
                    self._least_s = min(soonest_s, least_s + DRIFT * passed_s * (late_s < HEARD_S))
                elif counted > self._refused_counted:  # SYNCs were not sent, not received, or sent late
                    before, self._agrees = self._agrees, abs(late_s) <= unsure_s
                    right = before and self._agrees
            elif heard_apart_s is not None:
                heard = [
                    abs(one - passed_s) <= unsure_s for one in (apart_s, heard_apart_s) if one is not None
                ]
                right = all(heard) or (
                    right and (any(heard) or (is_timer and self._at_count) or not grid.period)
                )
            right &= off_s <= max(grid.allowed * TICK_S or unsure_s, harmless_s)
        else:
            error_s = abs((heard_apart_s if apart_s is None else apart_s) - passed_s) - DRIFT * passed_s
            right = error_s <= spare_s or (
                off_s <= spare_s and error_s < unsure_s and (apart_s is None or is_timer)
            )
        kind = REPEATED if heard_apart_s is None and grid.period and places < counted - 0.5 else SUSPECT
        if not right or kind == REPEATED:  # if right, then by its call: it is before the place of its count
            kind = intervals if right else kind
            return self._refused(time_100ns, ticks, counted, kind, received_s, synced_s)
        self._at_count = places == round(counted)
        # If SYNC has another rate, times do not agree with its count, and begin another line. Not while the
        # machine moves: what is declared for one interval would not hold for a longer one.
        is_same = heard_apart_s is None or self._at_count or not self._rests()
        grid.take(self._at + ticks, in_turn=is_same)
        self._take(
            time_100ns,
            ticks,
            _bounded(received_s, heard_apart_s, passed_s),
            _bounded(synced_s, apart_s, passed_s),
        )
        return intervals

    def _follow_pace(self, ticks: int, counted: float) -> bool:
        """Take another interval, the unit of speeds, if the measured one differs; False: not known yet."""
        pace_s = self.grid.rough * TICK_S or self._pace_s or max(0.0, ticks * TICK_S / counted)
        if abs(pace_s - self._pace_s) > SAME_PACE * pace_s:
            self._pace_s = pace_s
        return self.unit_s > 0.0

    def _take(self, time_100ns: int, ticks: int, received_s: float | None, synced_s: float | None) -> None:
        self._last, self._received_s, self._synced_s = time_100ns, received_s, synced_s
        self._at += ticks
        self._agrees, self._refused_counted = False, 0.0

    def _refused(
        self,
        time_100ns: int,
        ticks: int,
        counted: float,
        kind: float,
        received_s: float | None,
        synced_s: float | None,
    ) -> float:
        """``kind``, or RESTARTED if the refused times of several SYNCs in a row are a grid."""
        if counted <= self._refused_counted and kind != CROWDED:
            return kind
        self._refused_counted = counted
        grid, at = self.grid, self._at + ticks
        if not grid.period and kind == SUSPECT:
            grid.learn(at)  # a late SYNC does not disturb the clock of the interface
            return kind
        if grid.refuse(at):
            grid.set_again(grid.row)
            self._least_s = inf
            kind = RESTARTED
        elif kind > 0.0:  # `kind` is the intervals, right by its call: SYNC was late, or has another rate
            grid.skip(max(0, grid.nearest(at)[0]))
        if kind > 0.0 or kind == RESTARTED:
            self._take(time_100ns, ticks, received_s, synced_s)
        return kind


def _apart_s(before_s: float | None, now_s: float | None) -> float | None:
    return None if before_s is None or now_s is None else now_s - before_s


def _bounded(now_s: float | None, apart_s: float | None, passed_s: float) -> float | None:
    # Bounded, so that a late reception does not make the next times look wrong.
    if now_s is None or apart_s is None:
        return now_s
    by_s = HEARD_S + DRIFT * passed_s
    return now_s + min(max(apart_s, passed_s - by_s), passed_s + by_s) - apart_s
