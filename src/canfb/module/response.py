"""How long the encoder interface takes to answer a SYNC, and what a PDO at another time is."""

from __future__ import annotations

import math
from enum import Enum

LEARNED_SAMPLES = 16
LEARNED_TOGETHER = 8
WINDOW_SAMPLES = 128  # the shortest delay is that of one or two of these
LEAST_PART = 0.7  # of the shortest delay: no PDO answers faster
SPREADS = 4.0  # mean deviations around the usual delay, for a PDO after a gap
SPARE = 0.1  # period, at least
LATEST = 0.9  # period: before that the next SYNC is not due
NEXT_DUE = 1.1  # period: by then it was
LATER = 0.6  # period, than usual
RELEARN_SAMPLES = 8  # in a row that come too early


class Answer(Enum):
    """What a PDO is, by its delay after the last SYNC."""

    ON_TIME = "the answer to that SYNC"
    LATE = "the answer to a SYNC after it, which was not heard"
    UNCLEAR = "it may answer another SYNC"


class Response:
    """Follows the delay from SYNC to ADC PDO.

    The PDO carries no mark of the SYNC that it answers. One that comes sooner than the interface has
    ever answered is late, and answers the SYNC before. Where the PDO of the SYNC before is still
    missing, only one at the usual time is taken.

    For the hot path: a delay from ``low_s`` to ``high_s`` is that of the usual answer. It is not
    judged, but put into ``taken``; :meth:`learn` is called when LEARNED_TOGETHER have come.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Learn from the next samples."""
        self._seen = 0
        self._sooner = 0
        self._in_window = 0
        self.usual_s = 0.0
        """The usual delay, seconds."""
        self._spread_s = 0.0
        self._window_least_s = self._least_before_s = math.inf
        self._soonest_s = math.inf  # nothing answers faster
        self.taken: list[float] = []
        self.low_s, self.high_s = math.inf, -math.inf

    def learn(self, period_s: float) -> None:
        """The delays in ``taken``, seconds, all at once: nearly each sample brings one."""
        if self.taken:
            self._learn(self.taken, period_s)
            self.taken.clear()

    def judge(self, delay_s: float, longest_s: float, period_s: float, after_gap: bool) -> Answer:
        """The first PDO since a SYNC, ``delay_s`` after it, by no means more than ``longest_s``.

        ``after_gap``: the PDO of the SYNC before is missing.
        """
        self.learn(period_s)
        if self._seen < LEARNED_SAMPLES:
            if self.is_late(delay_s, period_s):
                return Answer.LATE
        elif longest_s < self._soonest_s:
            self._sooner += 1
            if self._sooner >= RELEARN_SAMPLES:
                self.forget()
            return Answer.UNCLEAR
        elif self.is_late(delay_s, period_s):
            return Answer.LATE
        elif self._is_unclear(delay_s, period_s, after_gap):
            return Answer.UNCLEAR
        self._learn([delay_s], period_s)
        return Answer.ON_TIME

    def _is_unclear(self, delay_s: float, period_s: float, after_gap: bool) -> bool:
        """About when the next SYNC is due, or not as usual where an earlier PDO is still missing."""
        later = delay_s - self.usual_s
        if after_gap and later > max(SPREADS * self._spread_s, SPARE * period_s):
            return True
        return delay_s > LATEST * period_s and later > LATER * period_s

    def is_late(self, delay_s: float, period_s: float) -> bool:
        """The next SYNC was due before, and the delay is as usual after that one."""
        return delay_s > NEXT_DUE * period_s and delay_s - self.usual_s > LATER * period_s

    def _learn(self, delays_s: list[float], period_s: float) -> None:
        if not self._seen:
            self.usual_s = delays_s[0]
        count, usual = len(delays_s), self.usual_s
        self._sooner = 0
        self._seen = min(self._seen + count, LEARNED_SAMPLES)
        gain = count / self._seen
        self._spread_s += (sum([abs(delay - usual) for delay in delays_s]) / count - self._spread_s) * gain
        self.usual_s += (sum(delays_s) / count - usual) * gain
        self._follow_least(min(delays_s), count)
        if self._seen >= LEARNED_SAMPLES:
            self.low_s, self.high_s = self._soonest_s, self.usual_s + SPARE * period_s

    def _follow_least(self, delay_s: float, samples: int) -> None:
        """The least delay of these samples; that of all is forgotten after one or two windows."""
        self._in_window += samples
        if self._in_window >= WINDOW_SAMPLES:
            self._in_window = 0
            self._least_before_s, self._window_least_s = self._window_least_s, math.inf
        self._window_least_s = min(self._window_least_s, delay_s)
        self._soonest_s = LEAST_PART * min(self._window_least_s, self._least_before_s)
