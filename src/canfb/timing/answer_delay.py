"""When the answer to a SYNC comes: which SYNCs an ADC PDO may answer, by its delay.

The PDO carries no mark of its SYNC. What its delay proves:

- Nothing answers a SYNC before the interface has measured: a delay below SOONEST of the shortest one so far
  belongs to an earlier SYNC.
- The PDOs of one node keep their order. If the SYNC before has been answered, a late PDO is not its answer.
- A frame waits for others, some 0.1 ms each, but not for periods. So within the usual delay, and where the
  one before is answered within LATEST, the PDO answers the last SYNC. Outside it may answer the SYNC
  before, while that has no answer; and, from the time on at which the next SYNC can have come and been
  answered, one that was not received.

Where more than one is left, all of them are the result, and the phases decide. (A PDO late by one period,
while the next one is lost, is within the usual delay: P3 and P7 of tools/faults/wire/README.md.)

| bound | value | reason |
|---|---|---|
| SOONEST | 0.7 of the shortest delay | conversion and transmission of the same frame, with other stuffing |
| SPREADS | 4 mean deviations | a frame before it on the bus; uniform: at most 2 |
| SPARE | 0.1 period | the shortest width of "usual" |
| LATEST | 0.9 period | beyond it the next SYNC is as near, by the jitter of both |
| MOST_LATE | 2 periods | a queue of PDOs of higher priority: more is a node that does not send |
"""

from __future__ import annotations

import math

SOONEST = 0.7
SPREADS = 4.0
SPARE = 0.1
LATEST = 0.9
MOST_LATE = 2
TOGETHER = 8  # delays that are learned at a time
LEARNED = 16  # delays; fewer say nothing
WINDOW = 128  # delays: the shortest is that of one or two of these
REFUSED = 8  # in a row that come sooner than any: the interface has become faster
MOST_NEWEST = 1 << 10  # SYNCs; more are as good as lost
ANSWERS_LAST = (0,)
ANSWERS_EARLIER = (-1,)


class AnswerDelay:
    """Follows the delay from SYNC to ADC PDO, seconds.

    A delay from ``low_s`` to ``high_s`` is usual: put it into ``unlearned``, and call :meth:`learn` when
    there are TOGETHER. ``mean_s`` is their mean.
    """

    __slots__ = (
        "_before_s",
        "_count",
        "_least_s",
        "_left",
        "_refused",
        "_spread_s",
        "high_s",
        "low_s",
        "mean_s",
        "unlearned",
    )  # fmt: skip

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Learn from the next delays."""
        self._count = self._refused = 0
        self._left = WINDOW
        self._least_s = self._before_s = math.inf
        self._spread_s = self.mean_s = 0.0
        self.unlearned: list[float] = []
        self.low_s, self.high_s = math.inf, -math.inf

    @property
    def learned(self) -> bool:
        """Enough delays are known."""
        return self._count >= LEARNED

    def is_usual(self, delay_s: float) -> bool:
        """False while too few delays are known."""
        return self.low_s <= delay_s <= self.high_s

    def learn(self, period_s: float) -> None:
        """Follow the delays in ``unlearned``, and empty it."""
        unlearned = self.unlearned
        if not unlearned:
            return
        size = len(unlearned)
        self._refused = 0
        self._count = min(self._count + size, LEARNED)
        gain = size / self._count
        self.mean_s += (sum(unlearned) / size - self.mean_s) * gain
        usual = self.mean_s
        self._spread_s += (sum([abs(one - usual) for one in unlearned]) / size - self._spread_s) * gain
        self._left -= size
        if self._left <= 0:
            self._left, self._before_s, self._least_s = WINDOW, self._least_s, math.inf
        self._least_s = min(self._least_s, *unlearned)
        unlearned.clear()
        if self._count >= LEARNED:
            self.low_s = SOONEST * min(self._least_s, self._before_s)
            spare_s = SPARE * period_s
            self.high_s = min(
                usual + max(spare_s, SPREADS * self._spread_s), max(LATEST * period_s, usual + spare_s)
            )

    def answers(
        self,
        delay_s: float,
        longest_s: float,
        period_s: float,
        before_open: bool,
        stamped: bool,
        next_s: float = 0.0,
    ) -> tuple[int, ...]:
        """Which SYNCs the first PDO since the last one may answer: 0 that one, -1 the one before, 1 the next.

        ``delay_s`` after it, by no means more than ``longest_s``; ``before_open``: the SYNC before has no
        answer yet. ``stamped``: it did not wait for the host, which may be late by any time. The next SYNC
        comes no sooner than ``next_s`` after the last one.
        """
        self.learn(period_s)
        passed = delay_s / period_s
        if self.learned:
            if longest_s < self.low_s:
                self._refused += 1
                if self._refused >= REFUSED:
                    self.forget()
                return ANSWERS_EARLIER
            if self.is_usual(delay_s):
                return ANSWERS_LAST
        elif passed < LATEST:
            return ANSWERS_LAST
        later = delay_s - self.mean_s
        soonest_s = next_s + (self.low_s if self.learned else 0.0)
        if passed < LATEST or later < SPARE * period_s or delay_s < soonest_s:
            return (-1, 0) if before_open else ANSWERS_LAST
        newest = max(1, min(round(later / period_s), MOST_NEWEST))
        return tuple(range(max(0, newest - MOST_LATE) if stamped else 0, newest + 1))
