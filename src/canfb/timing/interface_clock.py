"""The clock of the encoder interface: how many intervals lie between two sample times (2000:05).

The interface measures each interval itself, so the jitter of SYNC and the delays of the bus cost nothing,
and any number of missed samples has a known length. Only the ratio of differences matters, so neither does
the rate of that clock. But a time may be wrong: of another sample, of a clock that was set or that stands.
The phases do not show it where the machine goes whole cycles in the error. So each time is held against a
witness:

- the receptions of the SYNCs, where the bus gives them: the difference of two sample times is that of their
  SYNCs, within RECEPTION_S and the drift of two crystals. This finds errors of whole periods, too;
- the regularity of the sample times themselves: they lie on a grid, within the jitter of SYNC. The same
  filter follows it, a :class:`SyncClock` on the clock of the interface.

The sharper of both decides. Each has a limit of DEVIATIONS mean absolute deviations (as SYNC has), which
begins with what is declared and never exceeds it. What is refused is never learned from: the same error is
refused again, 30 or 600 samples later. :meth:`InterfaceClock.forget` forgets all of it.

A time that is refused costs its sample's exact instant, no more: the sample was taken at its SYNC, and the
error of that instant is what the judge gives for it. Where ANOTHER times in a row are refused and agree
with each other, the clock was set, and the last of them is the new reference. Where REFUSED are refused in
a row, what the witnesses claim is false, and both begin again.

After a gap SYNCs come off their grid, late by what has stalled their producer: the grid is no witness then.

| bound | value | reason |
|---|---|---|
| RECEPTION_S | 100 us | noise of a receive time of the kernel, and of the hold after the SYNC |
| LEAST_RECEPTION_S | 10 us | resolution of receive times, 100 ns of sample times, and the hold |
| OFF_GRID | 0.45 interval | as JITTER of sync_clock.py, which is the bound of the grid |
| DRIFT | 2e-4 | sync_clock.py |
| OLDEST | 64 intervals | a PDO that is sent again is one of the last; a clock that was set is anywhere |
"""

from __future__ import annotations

import math

from canfb.timing.sync_clock import DEVIATIONS, DRIFT, TOGETHER, SyncClock, is_regular

TICK_S = 1e-7
TICKS = 1 << 32
MASK = TICKS - 1
HALF_TICKS = TICKS // 2
RECEPTION_S = 100e-6
LEAST_RECEPTION_S = 10e-6
OFF_GRID = 0.45
HALF = 0.5
OLDEST = 64.0
SAME_UNIT = 0.02  # of the interval
ANOTHER = 3
REFUSED = 8
REGULAR = 6  # times in a row off the grid and regular, which their receptions show to be right
GAIN = 1.0 / 8.0


class InterfaceClock:
    """Elapsed intervals from sample times, and whether to believe them.

    ``unit_s`` is the interval in which elapsed times are given, seconds, 0.0: not known yet; it changes only
    where it is off by SAME_UNIT, as speeds are given in it. ``last`` is the last time that was taken,
    ``synced_s`` when its SYNC was received, None: not known. ``at_s`` is ``last`` in seconds of this clock,
    and ``grid`` what follows from all of them. A time from ``low_s`` to ``high_s`` after it was due is usual.
    """

    __slots__ = ("_before", "_counted", "_in_row", "_mean_s", "_off", "_refused", "at_s", "grid", "heard",
                 "high_s", "last", "limit_s", "longest_s", "low_s", "synced_s", "unit_s")  # fmt: skip

    def __init__(self) -> None:
        self.unit_s = 0.0
        self.grid = SyncClock()
        self.forget()

    def forget(self) -> None:
        """After a reset of the module: nothing is known of this clock."""
        self.grid.forget()
        self.heard: list[float] = []
        self._mean_s = RECEPTION_S / DEVIATIONS
        self.limit_s = RECEPTION_S
        """How far a difference of sample times may be from that of receptions, as measured, seconds."""
        self.pause()

    def pause(self) -> None:
        """The next time is the first one; how far receptions are off is still known."""
        self.last: int | None = None
        self.at_s = 0.0
        self.synced_s: float | None = None
        self._before: int | None = None  # the last time that was refused
        self._counted = 0.0  # periods counted up to it
        self._in_row = 0  # refused times that agree with each other
        self._refused = 0  # in a row
        self._set_grid()

    def _set_grid(self) -> None:
        """The grid begins with the last time."""
        self.grid.pause()
        self.grid.begin(self.at_s)
        self._off: list[float] = []  # right times that were off it
        self._look_ahead()

    def _look_ahead(self) -> None:
        grid = self.grid
        self.high_s = grid.jitter * grid.period_s if not self._off else 0.0
        self.low_s = -self.high_s
        self.longest_s = (1.0 + OFF_GRID) * grid.period_s

    def choose_unit(self, time_100ns: int, period_s: float, periods: int) -> None:
        """By the period of SYNC; 0.0, not known: by the first time, so many periods after ``last``."""
        if period_s:
            if abs(period_s - self.unit_s) > SAME_UNIT * period_s:
                self.unit_s = period_s
        elif not self.unit_s:
            self.unit_s = max(TICK_S, self.took_s(time_100ns)) / max(1, periods)

    def begin(self, time_100ns: int, synced_s: float | None) -> None:
        """The first time, or the first after the clock was set."""
        self.last, self.synced_s = time_100ns, synced_s
        self._before, self._in_row, self._refused = None, 0, 0
        self._set_grid()

    def took_s(self, time_100ns: int) -> float:
        """Seconds since ``last``, by this clock; negative for an earlier time. Needs ``last``."""
        assert self.last is not None
        ticks = (time_100ns - self.last) & MASK
        return (ticks - TICKS if ticks >= HALF_TICKS else ticks) * TICK_S

    def usual(self, time_100ns: int, synced_s: float | None) -> float:
        """Seconds since ``last`` for a time that is one period later, by both witnesses; 0.0: another one.

        It is taken then.
        """
        last, grid = self.last, self.grid
        if last is None:
            return 0.0
        took_s = ((time_100ns - last) & MASK) * TICK_S
        error = self.at_s + took_s - grid.due_s
        if not (self.low_s < error < self.high_s and took_s < self.longest_s):
            return 0.0
        before_s = self.synced_s
        if synced_s is not None and before_s is not None:
            heard = took_s - (synced_s - before_s)
            if not -self.limit_s < heard < self.limit_s:
                return 0.0
            self.heard.append(heard)
        self.last, self.synced_s = time_100ns, synced_s
        self.at_s += took_s
        grid.due_s += grid.period_s
        grid.errors.append(error)
        if len(grid.errors) >= TOGETHER:
            self._learn()
        return took_s

    def _learn(self) -> None:
        self.grid.learn(True)
        if heard := self.heard:
            mean_s = min(sum([abs(one) for one in heard]) / len(heard), RECEPTION_S)
            heard.clear()
            self._mean_s += (mean_s - self._mean_s) * GAIN
            self.limit_s = min(RECEPTION_S, max(LEAST_RECEPTION_S, DEVIATIONS * self._mean_s))
        self._look_ahead()

    def is_right(self, took_s: float, period_s: float, synced_s: float | None, after_gap: bool) -> bool:
        """Whether the witnesses agree with a time, ``took_s`` after the last one; the sharper one decides.

        ``synced_s`` is when its SYNC was received, None: not known; ``after_gap``: SYNCs are missing before
        it; ``period_s`` that of SYNC.
        """
        heard = self._heard(took_s, synced_s)
        if heard > HALF * period_s:  # the grid does not show whole periods
            return False
        if heard == heard and (after_gap or self.limit_s <= self.grid.jitter * period_s):
            return heard <= self.limit_s
        return after_gap or abs(self._off_grid(took_s, period_s)) <= self.grid.jitter

    def _heard(self, took_s: float, synced_s: float | None) -> float:
        """How far the receptions are off, seconds; nan: not known."""
        if synced_s is None or self.synced_s is None:
            return math.nan
        return abs(took_s - (synced_s - self.synced_s)) - DRIFT * abs(took_s)

    def _off_grid(self, took_s: float, period_s: float) -> float:
        """Periods from the grid."""
        grid = self.grid
        passed = (self.at_s + took_s - grid.due_s) / grid.period_s if grid.period_s else took_s / period_s
        return passed - round(passed)

    def take(self, time_100ns: int, took_s: float, synced_s: float | None) -> None:
        """This time is right."""
        heard, grid = self._heard(took_s, synced_s), self.grid
        if heard <= self.limit_s:
            self.heard.append(max(heard, 0.0))
        self.last, self.synced_s, self._before = time_100ns, synced_s, None
        self._refused = self._in_row = 0
        self.at_s += took_s
        if not grid.period_s:
            grid.start(self.at_s, True)
            self._look_ahead()
            return
        passed = (self.at_s - grid.due_s) / grid.period_s
        error = (passed - round(passed)) * grid.period_s
        grid.due_s += (1 + round(passed)) * grid.period_s
        if abs(error) <= grid.jitter * grid.period_s:
            self._off.clear()
            grid.errors.append(error)
            if len(grid.errors) >= TOGETHER:
                self._learn()
        else:
            self._off.append(self.at_s)
            if len(self._off) >= REGULAR:
                if is_regular(self._off):
                    grid.set_again(self._off)
                self._off.clear()
        self._look_ahead()

    def refuse(self, time_100ns: int, counted: float, period_s: float) -> bool:
        """This time is wrong, ``counted`` periods after ``last``; True if the clock was set, and goes on.

        Then this time is the reference, and how long it was since the last sample is not known by it.
        """
        before, self._before = self._before, time_100ns
        since, self._counted = counted - self._counted, counted
        self._refused += 1
        agrees = False
        if before is not None and since > 0.0:
            apart = ((time_100ns - before) & MASK) * TICK_S / period_s
            agrees = abs(apart - since) <= OFF_GRID
        self._in_row = self._in_row + 1 if agrees else 0
        if self._refused < REFUSED and self._in_row + 1 < ANOTHER:
            return False
        self._counted = 0.0
        if self._refused >= REFUSED:  # what the witnesses say is not so: nothing is known
            self.forget()
        self.begin(time_100ns, None)
        return True
