"""One grid: instants t0 + n T, each no further than the declared jitter from the line through those before.

SYNC comes at a fixed rate, and so do the samples that answer it. All that an instant says is at which place
it is, or that it is at none:

- a free place: the next one; places left out between are missing,
- the place of the last one: a second one,
- off the grid: nobody knows. ROW of them, regular among themselves, are the grid from there on.

The line is that of least squares, in recursive form, through the last ``memory`` instants. How far instants
are off it is shown, and judges nothing: what was seen is no bound of what may come.
"""

from __future__ import annotations

import math
from itertools import pairwise
from statistics import linear_regression, median

UNDECLARED = 0.45  # period: half a period away the next place is as near
REGULAR = 0.2  # of the interval: 135 us of 1 ms for a frame before a SYNC, and its producer
# Instants: the line of FIRST is within 0.25 of the rms jitter of one, per place; at LARGEST_FIRST those that
# jitter more give their line unchanged.
FIRST, LARGEST_FIRST = 6, 13
CALLS, MOST_CALLS = 9, 33  # that may be late: straight enough at once, or as they are
TOGETHER = 0.5  # of a period from one to the next: those that come faster have waited
STRAIGHT = 0.1  # period: calls no further above their line come from a host that is not late
ROW = 4
MEMORY = 256
LEARNED = 32  # from then on it may move positions
SHOWN = 64  # instants, over which the deviation is a mean
SAME_PERIOD = 0.03


class Grid:
    """``period``, ``due`` (the next place), ``jitter`` and instants in any one unit; 0.0: not known.

    ``lead`` is how much later than the last instant its place was, ``allowed`` how far one may be off,
    ``deviation`` the mean of how far they are. ``row``: the last instants that were not in turn.
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
        self.seen = 0  # Instants that carry the line.
        self.pause()

    def pause(self) -> None:
        """The period stays; the next instant gives the phase."""
        self.due = math.nan
        self.lead = 0.0
        self._fresh = 0
        self._first: list[float] = []
        self._end_row()
        self._find_gains()

    def _end_row(self) -> None:
        self.row: list[float] = []
        self._in_turn: list[bool] = []  # whether each of the row was
        self.early = 0  # Of the row, by calls.

    @property
    def locked(self) -> bool:
        """The line is good enough to move positions by it."""
        return self.seen >= LEARNED

    @property
    def rough(self) -> float:
        """The period, or while it is not known the median of the intervals so far; 0.0: none."""
        return self.period or (_median_apart(self._first) if len(self._first) > 1 else 0.0)

    def declare(self, jitter: float) -> None:
        """No instant is further from its place than this; 0.0: not declared."""
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
        """The same for instants that may be late: the line below them; not far below ``expected``."""
        first = self._first
        first.append(instant)
        del first[:-MOST_CALLS]
        if len(first) == MOST_CALLS or (len(first) >= CALLS and _is_straight(first)):
            line = _lowest(first)
            if not _waited(line, first, expected, True):
                self.set_again(line)
                self.seen = 2  # the two that it lies on: one of eight calls follows
                self._find_gains()

    def nearest(self, instant: float) -> tuple[int, float]:
        """Places from the last one to the nearest, and how much later than that the instant is."""
        later = instant - self.due
        places = round(later / self.period)
        return places + 1, later - places * self.period

    def follow(self, places: int, off: float, elapsed: int = 0) -> None:
        """An instant was taken ``places`` after the last, ``off`` its own.

        ``elapsed``: the line has grown by that many places since the last call, if not by ``places``.
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
        """An instant that is right, however far it is off the line: that goes on, or begins again there."""
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
        """Places passed, and nothing is known of them; or an instant of one was ``off``."""
        self.due += places * self.period
        self.lead = -off

    def refuse(self, instant: float) -> bool:
        """An instant that was not in turn; True if the last ROW are another grid: :meth:`set_again`.

        They are regular, and none was in turn, or they are not one period apart.
        """
        self._keep(instant, False, ROW)
        return len(self.row) == ROW and is_regular(self.row) and self._is_another

    def refuse_call(self, instant: float, early: bool, expected: float = 0.0) -> bool:
        """The same for one that may be late, but not ``early`` on this grid.

        FIRST with early ones are another grid if they lie on a line, and CALLS that are all late; MOST_CALLS
        are it as they are. None that waited for the host together are.
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
        """An instant was; the row is over if the one before was, too, or if all of them may only be late."""
        if not self.row or self._in_turn[-1] or (may_be_late and not self.early):
            self._end_row()
        else:
            self._keep(instant, True, MOST_CALLS)

    def _keep(self, instant: float, in_turn: bool, most: int) -> None:
        self.row.append(instant)
        self._in_turn.append(in_turn)
        del self.row[:-most], self._in_turn[:-most]

    def set_again(self, instants: list[float]) -> bool:
        """These regular instants are the grid; True if its period is another one."""
        apart = _median_apart(instants)
        if not apart > 0.0:  # frames of one instant say nothing of a period
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
        n = max(self.seen, 2)
        self._phase = max((4 * n - 2) / (n * (n + 1)), 1.0 / max(self._fresh, 1))
        self._slope = 6.0 / (n * (n + 1))
        self._shown = 1.0 / min(max(self._fresh, 1), SHOWN)
        most = UNDECLARED * self.period
        spare = 1.0 + 3.0 * math.sqrt(2.0 / max(self._fresh, 2))
        self.allowed = min(most, self._jitter * spare) if self._jitter else most


def _lowest(instants: list[float]) -> list[float]:
    """As many on the line below these: the side of their lower hull over the middle."""
    hull: list[tuple[int, float]] = []
    for c in enumerate(instants):
        while len(hull) > 1 and _is_above(hull[-2], hull[-1], c):
            hull.pop()
        hull.append(c)
    (a, left), (b, right) = next(pair for pair in pairwise(hull) if 2 * pair[1][0] >= len(instants) - 1)
    period = (right - left) / (b - a)
    return [left + (n - a) * period for n in range(len(instants))] if period > 0.0 else instants


def _waited(line: list[float], calls: list[float], period: float, early: bool) -> bool:
    """So fast another grid is only if all MOST_CALLS are, some of them ``early``."""
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
    """Whether their intervals agree with each other; one may be of ``most`` places."""
    middle = _median_apart(instants)
    if middle <= 0.0:
        return False
    apart = [(after - before) / middle for before, after in pairwise(instants)]
    return all(abs(one - min(max(1, round(one)), most)) <= REGULAR for one in apart)
