"""The clock of the encoder interface: how many intervals lie between two sample times (2000:05).

The interface measures each interval itself, so the jitter of SYNC and the delays of the bus cost nothing,
and any number of missed samples has a known length. Only the ratio of differences matters, so neither does
the rate of that clock. But a time may be wrong: of another sample, of a clock that was set or that stands.
The phases do not show it where the machine goes whole cycles in the error. So each time is held against a
witness:

- the receptions of the SYNCs, where the bus gives them: the difference of two sample times is that of their
  SYNCs, within RECEPTION_S and the drift of two crystals. This finds errors of whole periods, too;
- the regularity of the sample times themselves: they lie on a grid, as SYNCs do, within their jitter.

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
| OFF_GRID | 0.45 interval | jitter of SYNC; half an interval is as near to the next one |
| LEAST_OFF_GRID | 0.02 interval | the drift of the clock between two looks, and its resolution |
| DRIFT | 2e-4 | sync_clock.py |
| OLDEST | 64 intervals | a PDO that is sent again is one of the last; a clock that was set is anywhere |
"""

from __future__ import annotations

import itertools
import math
import statistics

from canfb.timing.sync_clock import DEVIATIONS, DRIFT

TICK_S = 1e-7
TICKS = 1 << 32
HALF_TICKS = TICKS // 2
RECEPTION_S = 100e-6
LEAST_RECEPTION_S = 10e-6
OFF_GRID = 0.45
LEAST_OFF_GRID = 0.02
OLDEST = 64.0
SAME_UNIT = 0.02  # of the interval
ANOTHER = 3
REFUSED = 8
GAIN = 1.0 / 64.0

LEARNED_SYNCS = 64
FIRST_SYNCS = 16
LEAST_APART = 0.5
MOST_MISSED = 16


class TimeDeviation:
    """How far a time usually is off, and the limit that follows, seconds or intervals."""

    __slots__ = ("_largest", "_least", "_mean", "limit")

    def __init__(self, least: float, largest: float) -> None:
        self._least, self._largest = least, largest
        self.forget()

    def forget(self) -> None:
        """What is declared is the limit."""
        self._mean, self.limit = self._largest / DEVIATIONS, self._largest

    def learn(self, off: float) -> None:
        """A time that was taken was off by so much, at least 0."""
        self._mean = mean = self._mean + (min(off, self._largest) - self._mean) * GAIN
        self.limit = min(self._largest, max(self._least, DEVIATIONS * mean))


class NominalGrid:
    """The grid of the sample times: when a SYNC without jitter would have come, by that clock.

    An alpha-beta filter with the gains of a straight line fitted to all times so far, held at those of
    ``memory_syncs`` of them. ``lead_ticks`` is how much later than the last time its nominal SYNC was,
    ``period_ticks`` from one to the next; 100 ns.
    """

    __slots__ = ("_first", "_last", "_memory_syncs", "lead_ticks", "period_ticks", "seen")

    def __init__(self, memory_syncs: int = 256) -> None:
        self._memory_syncs = memory_syncs
        self.forget()

    def forget(self) -> None:
        """Lock on the next samples."""
        self._last: int | None = None
        self._first: list[int] = []  # the first distances, ticks
        self.seen = 0
        self.lead_ticks = self.period_ticks = 0.0

    @property
    def locked(self) -> bool:
        """The lock is good enough to be used."""
        return self.seen >= LEARNED_SYNCS

    def off(self, time_100ns: int) -> float:
        """How far a time after the last one is from the grid, intervals, -0.5 .. 0.5. Needs :attr:`seen`."""
        assert self._last is not None
        passed = ((time_100ns - self._last) % TICKS - self.lead_ticks) / self.period_ticks
        return passed - round(passed)

    def take(self, time_100ns: int) -> None:
        """A sample was taken at this time, 0 .. 2^32 - 1."""
        last = self._last
        if last is None:
            self._last = time_100ns
            return
        ticks = (time_100ns - last) % TICKS
        if self.seen and ticks - self.lead_ticks < LEAST_APART * self.period_ticks:
            return  # the answer to a doubled SYNC
        self._last = time_100ns
        if not self.seen:
            self._begin(ticks)
            return
        syncs = round((ticks - self.lead_ticks) / self.period_ticks)
        if not 1 <= syncs <= MOST_MISSED:
            self.forget()
            self._last = time_100ns
            return
        lead = self.lead_ticks + syncs * self.period_ticks - ticks
        self.seen = n = min(self.seen + 1, self._memory_syncs)
        whole = (n + 1) * (n + 2)
        self.lead_ticks = lead * (1.0 - (4 * n + 2) / whole)
        self.period_ticks -= lead * 6.0 / whole / syncs

    def _begin(self, ticks: int) -> None:
        """A straight line through the first times; their median distance says how many SYNCs were missed."""
        if not ticks:
            return
        self._first.append(ticks)
        if len(self._first) < FIRST_SYNCS:
            return
        usual = statistics.median(self._first)
        syncs = list(itertools.accumulate((max(1, round(one / usual)) for one in self._first), initial=0))
        times = list(itertools.accumulate(self._first, initial=0))
        line = statistics.linear_regression(syncs, times)
        lead = line.intercept + line.slope * syncs[-1] - times[-1]
        straight = abs(lead) <= 0.5 * line.slope  # or these times are not those of a SYNC
        self.period_ticks, self.lead_ticks = (line.slope, lead) if straight else (float(usual), 0.0)
        self.seen = FIRST_SYNCS + 1


class InterfaceClock:
    """Elapsed intervals from sample times, and whether to believe them.

    ``unit_s`` is the interval in which elapsed times are given, seconds, 0.0: not known yet; it changes only
    where it is off by SAME_UNIT, as speeds are given in it. ``last`` is the last time that was taken,
    ``synced_s`` when its SYNC was received, None: not known.
    """

    __slots__ = ("_before", "_counted", "_in_row", "_refused", "grid", "last", "off_grid",
                 "reception", "synced_s", "unit_s")  # fmt: skip

    def __init__(self) -> None:
        self.unit_s = 0.0
        self.grid = NominalGrid()
        self.off_grid = TimeDeviation(LEAST_OFF_GRID, OFF_GRID)
        self.reception = TimeDeviation(LEAST_RECEPTION_S, RECEPTION_S)
        self.forget()

    def forget(self) -> None:
        """After a reset of the module: nothing is known of this clock."""
        self.grid.forget()
        self.off_grid.forget()
        self.reception.forget()
        self.pause()

    def pause(self) -> None:
        """The next time is the first one; how far times are off is still known."""
        self.last: int | None = None
        self.synced_s: float | None = None
        self._before: int | None = None  # the last time that was refused
        self._counted = 0.0  # intervals counted up to it
        self._in_row = 0  # refused times that agree with each other
        self._refused = 0  # in a row

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
        self.grid.take(time_100ns)

    def took_s(self, time_100ns: int) -> float:
        """Seconds since ``last``, by this clock; negative for an earlier time. Needs ``last``."""
        assert self.last is not None
        ticks = (time_100ns - self.last) % TICKS
        return (ticks - TICKS if ticks >= HALF_TICKS else ticks) * TICK_S

    def is_right(
        self, time_100ns: int, took_s: float, period_s: float, synced_s: float | None, after_gap: bool
    ) -> bool:
        """Whether the witnesses agree with this time, ``took_s`` after the last one.

        ``synced_s`` is when its SYNC was received, None: not known; ``after_gap``: SYNCs are missing before
        it; ``period_s`` that of SYNC.
        """
        heard, grid = math.nan, math.nan
        if synced_s is not None and self.synced_s is not None:
            heard = abs(took_s - (synced_s - self.synced_s)) - DRIFT * took_s
        if not after_gap:
            passed = took_s / period_s
            grid = abs(self.grid.off(time_100ns) if self.grid.seen else passed - round(passed))
        if heard == heard and (grid != grid or self.reception.limit <= self.off_grid.limit * period_s):
            right = heard <= self.reception.limit
        else:
            right = not grid > self.off_grid.limit
        if right:
            if heard == heard:
                self.reception.learn(max(heard, 0.0))
            if grid == grid:
                self.off_grid.learn(grid)
        return right

    def take(self, time_100ns: int, synced_s: float | None) -> None:
        """This time is right."""
        self.last, self.synced_s, self._before = time_100ns, synced_s, None
        self._refused = self._in_row = 0
        self.grid.take(time_100ns)

    def refuse(self, time_100ns: int, counted: float, period_s: float) -> bool:
        """This time is wrong, ``counted`` periods after ``last``; True if the clock was set, and goes on.

        Then this time is the reference, and how long it was since the last sample is not known by it.
        """
        before, self._before = self._before, time_100ns
        since, self._counted = counted - self._counted, counted
        self._refused += 1
        agrees = False
        if before is not None and since > 0.0:
            apart = (time_100ns - before) % TICKS * TICK_S / period_s
            agrees = abs(apart - since) <= OFF_GRID
        self._in_row = self._in_row + 1 if agrees else 0
        if self._refused >= REFUSED:
            self.off_grid.forget()
            self.reception.forget()
        elif self._in_row + 1 < ANOTHER:
            return False
        self._counted = 0.0
        self.grid.forget()
        self.begin(time_100ns, None)
        return True
