"""Which SYNC an ADC PDO answers. It carries no mark of it: what is left is its time, and the order.

With receive times of both: nothing answers a SYNC before the interface has measured, so a PDO is no sooner
than the least delay so far; and a frame waits for others, some 0.1 ms each, but not a quarter of a period. So
it answers the SYNC that was received the least delay before it, or up to LATEST more, and the jitter of SYNC
if a timer that is locked to it takes the samples. One that fits none is not used; ROW of them with one delay
have another one. Without receive times it answers the last SYNC.
With a longest delay (2010:0E) it may come behind later SYNCs.
"""

from __future__ import annotations

from math import inf

from canfb.timing.grid import ROW, Grid
from canfb.timing.syncs import Syncs

SOONEST = 0.7  # of the least delay: the same frame, with other stuffing
NOISE_S = 50e-6  # of two receive times
# At a bus load of 30 % SYNC waits so long for frames of 135 us, in the mean: the line lies behind a timer.
QUEUED_S = 20e-6
LATEST = 0.25  # period
WIDEST = 0.7  # period, with all of the jitter: less is left for those that are early
FORGETTING = 1e-3  # of the difference to the present delay


class Answers:
    """``least_s`` is the shortest delay from SYNC to PDO, seconds; inf while none is known."""

    __slots__ = ("_longest_s", "_refused", "least_s", "synced_s", "waits")

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        self.least_s = inf
        # So many SYNCs may come before the answer to an earlier one; and when those were received, by place.
        self._longest_s, self.waits = 0.0, 0
        self.synced_s: dict[int, float] = {}
        self._refused: dict[float, float] = {}  # by the place of the next SYNC: several of one are copies

    def synced(self, place: int, synced_s: float, grid: Grid, longest_s: float) -> None:
        """A SYNC; ``longest_s`` 0.0: less than a period."""
        self._longest_s = longest_s
        latest_s = min(longest_s, self.least_s + _most_s(grid, grid.rough)) + grid.allowed
        self.waits = int(latest_s / grid.rough) if longest_s and grid.rough else 0
        self.synced_s = {place: synced_s} | {
            one: at_s for one, at_s in self.synced_s.items() if place - self.waits <= one < place
        }

    def is_usual(self, delay_s: float, grid: Grid) -> bool:
        """It answers the SYNC so long before it, within the usual delay."""
        later_s = delay_s - self.least_s
        if self._refused or not 0.0 <= later_s <= _most_s(grid, grid.period) or self.is_early(delay_s, grid):
            return False
        self.least_s += FORGETTING * later_s
        return True

    def is_early(self, delay_s: float, grid: Grid) -> bool:
        """Its SYNC came before its place on the grid, and it sooner than from a timer: so did its sample."""
        return grid.lead > 0.0 and delay_s + QUEUED_S < grid.lead + SOONEST * self.least_s < inf

    def place(self, delay_s: float, syncs: Syncs, answered: int = -1) -> int | None:
        """Places after the last SYNC that it answers: 0 that one, -1 the one before; None: it fits none.

        ``delay_s`` after the last SYNC; the place that is ``answered`` needs no other. An earlier SYNC
        counts by its receive time, where that is known.
        """
        period_s = syncs.grid.period
        if self._longest_s and not period_s:  # how many periods a delay is cannot be said yet
            return min(0, answered + 1)
        if self.least_s == inf:
            self.least_s = self._since_first(delay_s, period_s)
        early_s = max((1.0 - SOONEST) * min(self.least_s, period_s), min(NOISE_S, 0.1 * period_s))
        most_s = _most_s(syncs.grid, period_s)
        newest = round((delay_s - self.least_s + early_s) // period_s) if period_s else 0
        near = [one for one in (newest - 1, newest + 1) if one <= 0 and self.synced_s]
        fits = []
        for places in (newest, *near):
            later_s = delay_s - self._since_s(places, syncs, period_s) - self.least_s
            may_come = places > 0 and later_s < (SOONEST - 1.0) * self.least_s  # a SYNC that was not received
            if (-early_s <= later_s <= most_s and not may_come) or not period_s:
                fits.append((places, later_s))
        if len(fits) == 1 and fits[0][0] > answered:
            later_s = fits[0][1]
            self.least_s += (FORGETTING if later_s >= 0.0 else 1.0) * later_s
            self._refused.clear()
        else:
            self._refused.setdefault(syncs.grid.due, delay_s)
        return fits[0][0] if len(fits) == 1 else None

    def _since_s(self, places: int, syncs: Syncs, period_s: float) -> float:
        at_s = self.synced_s.get(syncs.place + places)
        return places * period_s if at_s is None else at_s - syncs.synced_s

    def has_moved(self, grid: Grid) -> bool:
        """ROW were refused in a row, with much the same delay: that is the delay from now on."""
        refused = self._refused
        if len(refused) < ROW:
            return False
        if max(refused.values()) - min(refused.values()) > LATEST * grid.period:
            del refused[min(refused)]
            return False
        self.least_s = self._since_first(min(refused.values()), grid.period)
        refused.clear()
        return True

    def _since_first(self, delay_s: float, period_s: float) -> float:
        return delay_s + max(0.0, (self._longest_s - delay_s) // (period_s or inf)) * period_s


def _most_s(grid: Grid, period_s: float) -> float:
    """How much later than the least a PDO may be, seconds."""
    return min(LATEST * period_s + grid.allowed, WIDEST * period_s)
