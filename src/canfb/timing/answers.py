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

    def place(self, delay_s: float, grid: Grid, answered: int = -1) -> int | None:
        """Places after the last SYNC that it answers: 0 that one, -1 the one before; None: it fits none.

        ``delay_s`` after the last SYNC; the place that is ``answered`` needs no other.
        """
        period_s = grid.rough if self._longest_s else grid.period
        if self.least_s == inf:
            self.least_s = self._since_first(delay_s, period_s)
        later_s = delay_s - self.least_s
        early_s = max((1.0 - SOONEST) * self.least_s, min(NOISE_S, 0.1 * period_s))
        places = round((later_s + early_s) // period_s) if period_s else 0
        within_s = later_s - places * period_s
        may_come = places > 0 and within_s < (SOONEST - 1.0) * self.least_s  # a SYNC that was not received
        fits = (-early_s <= within_s <= _most_s(grid, period_s) and not may_come) or not period_s
        if fits and places > answered:
            self.least_s += (FORGETTING if within_s >= 0.0 else 1.0) * within_s
            self._refused.clear()
        else:
            self._refused.setdefault(grid.due, delay_s)
        return places if fits else None

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
