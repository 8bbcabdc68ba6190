"""A grid of instants t0 + n T, which estimates phase and period, and finds the place n of an instant.

SYNC comes at a fixed rate, and so do the samples that answer it. An instant is within the declared jitter
of a place, or it is off the grid:

- at a free place: the next instant; places passed over are missing,
- at the place of the last instant: a second one,
- off the grid: nothing is known. ROW of them, regular among themselves, are the new grid.

t0 and T are a least squares fit, in recursive form, to the last ``memory`` instants. The deviation from the
fit is measured, but never narrows what is allowed: past deviations do not bound future ones.
"""

from __future__ import annotations

import math
from itertools import pairwise
from statistics import linear_regression, median

UNDECLARED = 0.45  # periods allowed if no jitter is declared; at 0.5 the next place is as near
REGULAR = 0.2  # relative tolerance of an interval: at 1 kHz, 135 us of waiting, and jitter of the producer
# Number of instants for the first line: FIRST if they are regular (the error of the period is then 0.24 times
# the rms jitter of an instant), LARGEST_FIRST in any case.
FIRST, LARGEST_FIRST = 6, 13
CALLS, MOST_CALLS = 9, 33  # the same for calls, which may be late: CALLS if straight, or MOST_CALLS
TOGETHER = 0.5  # periods: calls that follow each other faster have queued while the host was late
STRAIGHT = 0.1  # periods: a host is not late if no call is further above the line below them
ROW = 4  # instants off the grid, regular among themselves, that are a new grid
MEMORY = 256
LEARNED = 32  # instants after which the line is good enough to move positions
SHOWN = 64  # instants over which the deviation is averaged
SAME_PERIOD = 0.03  # relative difference up to which a period is the same


class Grid:
    """Instants, ``jitter``, ``period`` and ``due`` (the next place) have one unit, any; 0.0: not known.

    ``lead`` is place minus instant for the last one, ``allowed`` the largest distance of an instant from its
    place, ``deviation`` the mean of that distance. ``row`` holds the instants since one was not in turn.
    """

    __slots__ = (
        "_first",
        "_fresh",
        "_in_turn",
        "_jitter",
        "_phase",
        "_shown",
        "_slope",
        "allowed",
        "deviation",
        "due",
        "early",
        "lead",
        "memory",
        "period",
        "row",
        "seen",
    )

    def __init__(self, memory: int = MEMORY, jitter: float = 0.0) -> None:
        self.memory, self._jitter = memory, jitter
        self.forget()

    def forget(self) -> None:
        self.period = self.deviation = 0.0
        self.seen = 0  # instants that the line is fitted to, at most `memory`
        self.pause()

    def pause(self) -> None:
        """Keep the period; take the phase from the next instant."""
        self.due = math.nan
        self.lead = 0.0
        self._fresh = 0  # instants since the phase was forgotten
        self._first: list[float] = []  # instants before the first line
        self._end_row()
        self._find_gains()

    def _end_row(self) -> None:
        self.row: list[float] = []
        self._in_turn: list[bool] = []  # for each instant of the row
        self.early = 0  # calls of the row that were earlier than this grid allows

    @property
    def locked(self) -> bool:
        """True if the line is good enough to move positions by it."""
        return self.seen >= LEARNED

    @property
    def rough(self) -> float:
        """The period; before it is known, the median of the intervals so far; 0.0: none yet."""
        return self.period or (_median_apart(self._first) if len(self._first) > 1 else 0.0)

    def declare(self, jitter: float) -> None:
        """Set ``jitter``, the largest distance of an instant from its place; 0.0: not declared."""
        self._jitter = jitter
        self._find_gains()

    def begin(self, instant: float) -> None:
        self._first, self._fresh = [instant], 1
        self.due = instant + self.period
        self._find_gains()

    def learn(self, instant: float) -> None:
        first = self._first
        first.append(instant)
        del first[:-LARGEST_FIRST]
        if len(first) == LARGEST_FIRST:
            self.set_again(first)
        elif len(first) >= FIRST and is_regular(first[-FIRST:], 2):
            self.set_again(first[-FIRST:])

    def learn_earliest(self, instant: float, expected: float = 0.0) -> None:
        """:meth:`learn` for calls, which may be late: fit the line below them.

        ``expected`` is the period known from elsewhere, 0.0: none; a much shorter one is not taken.
        """
        first = self._first
        first.append(instant)
        del first[:-MOST_CALLS]
        if len(first) == MOST_CALLS or (len(first) >= CALLS and _is_straight(first)):
            line = _lowest(first)
            if not _waited(line, first, expected, True):
                self.set_again(line)
                self.seen = 2  # the line goes through two calls; after this one call in eight feeds it
                self._find_gains()

    def nearest(self, instant: float) -> tuple[int, float]:
        """Places from the last one to the nearest one, and instant minus place."""
        later = instant - self.due
        places = round(later / self.period)
        return places + 1, later - places * self.period

    def follow(self, places: int, off: float, elapsed: int = 0) -> None:
        """Fit the line to an instant, ``places`` after the last one and ``off`` its own place.

        ``elapsed``: places since the last fit, where that is not ``places``.
        """
        if self._fresh < self.memory:
            self._fresh += 1
            self.seen = min(self.seen + 1, self.memory)
            self._find_gains()
        before, phase = self.period, off * self._phase
        self.period = period = before + self._slope * off / (elapsed or places)
        self.lead = phase - off
        self.due += (places - 1) * before + phase + period
        self.deviation += (abs(off) - self.deviation) * self._shown

    def take(self, instant: float, in_turn: bool = True) -> None:
        """Use an instant that is right, near the line or not: fit the line to it, or begin a new one there.

        ``in_turn`` False: it belongs to another grid.
        """
        if math.isnan(self.due):
            self.begin(instant)
        elif not self.period:
            self.learn(instant)
        else:
            places, off = self.nearest(instant)
            if in_turn and places > 0 and abs(off) <= self.allowed:
                self.is_in_turn(instant)
                self.follow(places, off)
            elif self.refuse(instant):
                self.set_again(self.row)
            else:
                self.skip(max(places, 0), off)

    def skip(self, places: int, off: float = 0.0) -> None:
        """Pass ``places`` without a fit; ``off``: distance of an instant that is not used."""
        self.due += places * self.period
        self.lead = -off

    def refuse(self, instant: float) -> bool:
        """Note an instant that was not in turn; True if the last ROW are another grid: :meth:`set_again`.

        They are if regular, and none was in turn or their interval is not the period.
        """
        self._keep(instant, False, ROW)
        return len(self.row) == ROW and is_regular(self.row) and self._is_another

    def refuse_call(self, instant: float, early: bool, expected: float = 0.0) -> bool:
        """:meth:`refuse` for a call, which may be late, but cannot be ``early`` on its own grid.

        Another grid: FIRST calls on a line if several were early, else CALLS on a line, or the line below
        MOST_CALLS. Calls that have queued are no grid. ``expected`` as in :meth:`learn_earliest`.
        """
        self.early += early
        self._keep(instant, False, MOST_CALLS)
        row, enough = self.row, FIRST if self.early > 1 else CALLS
        line = _lowest(row) if self.early < 2 and len(row) == MOST_CALLS else row[-enough:]
        if (
            len(row) < enough
            or not _is_straight(line)
            or _waited(line, row, expected if self.early else self.period, self.early > 1)
        ):
            return False
        self.row, self._in_turn = line, self._in_turn[-len(line) :]
        return self._is_another

    @property
    def _is_another(self) -> bool:
        return not any(self._in_turn) or abs(_median_apart(self.row) / self.period - 1.0) > REGULAR

    def is_in_turn(self, instant: float, may_be_late: bool = False) -> None:
        """Note an instant that was in turn. It ends the row if the one before was in turn, too.

        With ``may_be_late`` it also ends a row of calls of which none was early: they were only late.
        """
        if not self.row or self._in_turn[-1] or (may_be_late and not self.early):
            self._end_row()
        else:
            self._keep(instant, True, MOST_CALLS)

    def _keep(self, instant: float, in_turn: bool, most: int) -> None:
        self.row.append(instant)
        self._in_turn.append(in_turn)
        del self.row[:-most], self._in_turn[:-most]

    def set_again(self, instants: list[float]) -> bool:
        """Fit the line to these regular ``instants``; True if the period has changed."""
        apart = _median_apart(instants)
        if not apart > 0.0:  # frames with one instant show no period
            self._first = instants[-1:]
            return False
        places = [0.0]
        for before, after in pairwise(instants):
            places.append(places[-1] + max(1, round((after - before) / apart)))
        line, before = linear_regression(places, instants), self.period
        same = abs(line.slope - before) <= SAME_PERIOD * before
        self.period = before if same and self.seen > len(instants) else line.slope
        self.seen = self.seen if same else len(instants)
        self._fresh = len(instants)
        mean = sum(instants) / len(instants), sum(places) / len(places)
        self.due = mean[0] + (places[-1] - mean[1] + 1.0) * self.period
        self._end_row()
        self._first = []
        self._find_gains()
        return not same

    def _find_gains(self) -> None:
        # Gains of recursive least squares after n instants. `allowed` is the jitter with a margin for the
        # error of the line, which shrinks as 1 / sqrt(n).
        n = max(self.seen, 2)
        self._phase = max((4 * n - 2) / (n * (n + 1)), 1.0 / max(self._fresh, 1))
        self._slope = 6.0 / (n * (n + 1))
        self._shown = 1.0 / min(max(self._fresh, 1), SHOWN)
        most = UNDECLARED * self.period
        spare = 1.0 + 3.0 * math.sqrt(2.0 / max(self._fresh, 2))
        self.allowed = min(most, self._jitter * spare) if self._jitter else most


def _lowest(instants: list[float]) -> list[float]:
    """As many instants on the line below these: the side of their lower convex hull below the middle one."""
    hull: list[tuple[int, float]] = []
    for c in enumerate(instants):
        while len(hull) > 1 and _is_above(hull[-2], hull[-1], c):
            hull.pop()
        hull.append(c)
    (a, left), (b, right) = next(pair for pair in pairwise(hull) if 2 * pair[1][0] >= len(instants) - 1)
    period = (right - left) / (b - a)
    return [left + (n - a) * period for n in range(len(instants))] if period > 0.0 else instants


def _waited(line: list[float], calls: list[float], period: float, early: bool) -> bool:
    """True if the calls on ``line`` follow each other too fast for a grid: they have queued.

    Not if all MOST_CALLS are as fast, and several were ``early``.
    """
    apart, all_apart = ((one[-1] - one[0]) / (len(one) - 1) for one in (line, calls))
    return apart < TOGETHER * period and (
        not early or len(calls) < MOST_CALLS or all_apart >= TOGETHER * period
    )


def _is_straight(instants: list[float]) -> bool:
    low = _lowest(instants)
    return all(one - below <= STRAIGHT * (low[1] - low[0]) for one, below in zip(instants, low, strict=True))


def _is_above(a: tuple[int, float], b: tuple[int, float], c: tuple[int, float]) -> bool:
    return (b[1] - a[1]) * (c[0] - a[0]) >= (c[1] - a[1]) * (b[0] - a[0])


def _median_apart(instants: list[float]) -> float:
    return median([after - before for before, after in pairwise(instants)])


def is_regular(instants: list[float], most: int = 1) -> bool:
    """True if the intervals agree with each other; an interval may have up to ``most`` places."""
    middle = _median_apart(instants)
    if middle <= 0.0:
        return False
    apart = [(after - before) / middle for before, after in pairwise(instants)]
    return all(abs(one - min(max(1, round(one)), most)) <= REGULAR for one in apart)
