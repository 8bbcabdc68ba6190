"""Which SYNC an ADC PDO answers. The PDO itself does not show it, only its receive time and the order.

With receive times of both, the delay from SYNC to PDO has a range. It begins at the least delay so far, since
the interface has to measure first. It is as wide as LATEST periods, for other frames (some 0.1 ms each), plus
the jitter of SYNC, if a timer locked to SYNC takes the samples. The PDO answers the one SYNC for which its
delay is in this range; if there is none, it is not used. ROW of them with one delay give a new least delay.
Without receive times, a PDO answers the last SYNC.
With a declared longest delay (2010:0E), it may come after later SYNCs.
"""

from __future__ import annotations

from math import inf

from canfb.timing.grid import ROW, Grid
from canfb.timing.syncs import Syncs

SOONEST = 0.7  # of the least delay: the same PDO may be shorter, with fewer stuff bits
NOISE_S = 50e-6  # of the difference of two receive times
# Mean time that SYNC waits for frames of 135 us at 30 % bus load. The line through received SYNCs is late by
# this; a timer of the interface may be in time.
QUEUED_S = 20e-6
LATEST = 0.25  # periods by which a PDO may be later than the least delay
WIDEST = 0.7  # largest width of the range with all of the jitter, periods; the rest is for early PDOs
FORGETTING = 1e-3  # share of (delay - least delay) by which each PDO raises the least delay


class Answers:
    """``least_s``: least delay from SYNC to PDO, seconds, slowly forgotten; inf while it is not known."""

    __slots__ = ("_longest_s", "_refused", "least_s", "synced_s", "waits")

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        self.least_s = inf
        # The declared longest delay, 0.0: less than a period; and how many later SYNCs may come before the
        # answer to a SYNC.
        self._longest_s, self.waits = 0.0, 0
        self.synced_s: dict[int, float] = {}  # receive times of SYNCs that may still be answered, by place
        # Delays of the PDOs that fitted no SYNC, by the place of the next SYNC: one for each interval, since
        # more of them in one interval are copies.
        self._refused: dict[float, float] = {}

    def synced(self, place: int, synced_s: float, grid: Grid, longest_s: float) -> None:
        """Note a SYNC; ``longest_s``: the declared longest delay, 0.0: less than a period."""
        self._longest_s = longest_s
        latest_s = min(longest_s, self.least_s + _most_s(grid, grid.rough)) + grid.allowed
        self.waits = int(latest_s / grid.rough) if longest_s and grid.rough else 0
        self.synced_s = {place: synced_s} | {
            one: at_s for one, at_s in self.synced_s.items() if place - self.waits <= one < place
        }

    def is_usual(self, delay_s: float, grid: Grid) -> bool:
        """True if a PDO ``delay_s`` after a SYNC is its answer, with a usual delay; follows that delay."""
        later_s = delay_s - self.least_s
        if self._refused or not 0.0 <= later_s <= _most_s(grid, grid.period) or self.is_early(delay_s, grid):
            return False
        self.least_s += FORGETTING * later_s
        return True

    def is_early(self, delay_s: float, grid: Grid) -> bool:
        """True if the sample was taken at a SYNC that came before its place: a timer would answer later."""
        return grid.lead > 0.0 and delay_s + QUEUED_S < grid.lead + SOONEST * self.least_s < inf

    def place(self, delay_s: float, syncs: Syncs, answered: int = -1) -> int | None:
        """What a PDO ``delay_s`` after the last SYNC answers: 0 that SYNC, -1 the one before; None: unknown.

        ``answered`` is the last place that has its sample: another PDO for it teaches no delay. For an
        earlier SYNC the receive time is used where it is known, else its place on the grid.
        """
        period_s = syncs.grid.period
        if self._longest_s and not period_s:  # a delay cannot be divided into periods yet
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
            # Too soon for an answer to a SYNC that was lost: that SYNC may still come.
            may_come = places > 0 and later_s < (SOONEST - 1.0) * self.least_s
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
        """True if ROW PDOs in a row fitted no SYNC and had about one delay: the least one from now on."""
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
        # As many periods more as the declared longest delay allows: the PDO may answer the earliest SYNC.
        return delay_s + max(0.0, (self._longest_s - delay_s) // (period_s or inf)) * period_s


def _most_s(grid: Grid, period_s: float) -> float:
    """By how much a delay may exceed the least one, seconds."""
    return min(LATEST * period_s + grid.allowed, WIDEST * period_s)
