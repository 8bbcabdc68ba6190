"""The nominal SYNC: when a SYNC without jitter would have come, by the clock of the encoder interface.

A timer of a drive locks on SYNC; this is the same lock on sample times (2000:05): the straight line through
all of them, held at the last ``memory_syncs``. Its gains are those of the least squares line through n + 1
points. Of the jitter of SYNC 2 / sqrt(memory) of the rms value is left, of the drift of the clock nothing.

It begins with the second distance: through fewer than FIRST_SYNCS goes the line of the median slope and the
median offset (Theil, Sen), which a few wrong times do not move.

The line is the one estimate of that clock: how long an interval is (:mod:`canfb.signal.sample_times`), how
far a time is off, where the samples within an interval lie, and to which instant 2013:02 moves a position. A
time is held against the line, and not against the one before: of two times that jitter, only one enters.
"""

from __future__ import annotations

from itertools import accumulate, combinations
from statistics import linear_regression, median

from canfb.signal.sample import TICKS

MEMORY_SYNCS = 256  # that the lock remembers, about
LEARNED_SYNCS = 64  # from then on positions are moved by it
FIRST_SYNCS = 16  # distances, for the first straight line
BEFORE = 5  # slopes as before, beside those of the first: fewer that jitter make no other period
LEAST_APART = 0.5  # of the period
MOST_MISSED = 16  # from one sample to the next: beyond that the clock was started again


class NominalSync:
    """``lead_ticks`` is how much later than the last sample its nominal SYNC was, ``period_ticks`` from
    one nominal SYNC to the next; both in 100 ns of the interface's clock, 0.0 while they are not known.
    """

    __slots__ = (
        "_before",
        "_first",
        "_last",
        "_phase",
        "_skipped",
        "_slope",
        "first_off_ticks",
        "lead_ticks",
        "memory_syncs",
        "period_ticks",
        "seen",
    )

    def __init__(self, memory_syncs: int = MEMORY_SYNCS) -> None:
        self.memory_syncs = memory_syncs
        self.forget()

    def forget(self) -> None:
        """Lock on the next samples, of which nothing is known."""
        self.period_ticks = 0.0
        self.restart()

    def expect(self, period_ticks: float) -> None:
        """The period is said to be this; the samples may soon show another one."""
        self.period_ticks = period_ticks
        self.restart()

    def restart(self) -> None:
        """Lock on the next samples; the period stays until they show it."""
        self._last: int | None = None
        self._before = [self.period_ticks] * BEFORE if self.period_ticks else []
        self._first: list[tuple[float, float]] = []  # the first distances, ticks, and SYNCs in them
        self._skipped = 0.0  # ticks to a sample that is none of the line, while there is no line
        self._phase = self._slope = 0.0  # gains
        self.lead_ticks = 0.0
        self.first_off_ticks: list[float] = []
        """How far the first samples are off the line that begins with them."""
        self.seen = 0
        """Samples that the line stands on, 0 before there is one; at most ``memory_syncs``."""

    @property
    def locked(self) -> bool:
        """The lock is good enough to move positions by it."""
        return self.seen >= LEARNED_SYNCS

    def off_ticks(self, ticks: float, syncs: float) -> float:
        """By how much a sample ``ticks`` and ``syncs`` after the last one is later than the line has it."""
        return ticks - self.lead_ticks - syncs * self.period_ticks

    def take(self, ticks: float, syncs: float) -> None:
        """A sample was taken so many ticks after the last one, and so many SYNCs, both above 0.

        ``syncs`` may be 0.0 before there is a line: nobody has counted them.
        """
        if self.seen:
            self.follow(self.off_ticks(ticks, syncs), syncs)
        else:
            self._begin(ticks + self._skipped, syncs)
            self._skipped = 0.0

    def follow(self, off_ticks: float, syncs: float = 1.0) -> None:
        """:meth:`take` where there is a line, of a sample that was off it by so much."""
        if self.seen < self.memory_syncs:
            self.seen = n = self.seen + 1
            whole = (n + 1) * (n + 2)
            self._phase, self._slope = (4 * n + 2) / whole, 6.0 / whole
        self.lead_ticks = off_ticks * (self._phase - 1.0)
        self.period_ticks += off_ticks * self._slope / syncs

    def skip(self, ticks: float) -> None:
        """A sample was taken so long after the last one, at no SYNC of the line, which goes on as it was."""
        period = self.period_ticks
        if not self.seen:
            self._skipped += ticks
        elif period:
            self.lead_ticks += round((ticks - self.lead_ticks) / period) * period - ticks

    def _begin(self, ticks: float, syncs: float) -> None:
        """The line through the first samples, which single wrong times do not move."""
        first = self._first
        first.append((ticks, syncs))
        usual = median([one / (n or 1.0) for one, n in first] + self._before)
        counted = (n or max(1.0, round(one / usual)) for one, n in first)
        places = list(accumulate(counted, initial=0.0))
        times = list(accumulate((one for one, _ in first), initial=0.0))
        slope, begins = self._through(places, times)
        lead = begins + slope * places[-1] - times[-1]
        if abs(lead) <= LEAST_APART * slope:
            self.period_ticks, self.lead_ticks = slope, lead
            self.first_off_ticks = [
                time - begins - place * slope for place, time in zip(places, times, strict=True)
            ]
        else:  # these times are not those of a SYNC
            self.period_ticks, self.lead_ticks = usual, 0.0
        if len(first) >= FIRST_SYNCS:
            self.seen = FIRST_SYNCS + 1
            first.clear()

    def _through(self, places: list[float], times: list[float]) -> tuple[float, float]:
        """Slope and intercept: the median ones, and of least squares once there are enough."""
        if len(places) > FIRST_SYNCS:
            return linear_regression(places, times)
        slopes = [(b - a) / (q - p) for (p, a), (q, b) in combinations(zip(places, times, strict=True), 2)]
        slope = median(slopes + self._before)
        return slope, median([time - place * slope for place, time in zip(places, times, strict=True)])

    def sample(self, time_100ns: int) -> None:
        """A sample was taken at this time, 0 .. 2^32 - 1, for which nobody has counted SYNCs."""
        last, self._last = self._last, time_100ns
        if last is None:
            return
        ticks = (time_100ns - last) % TICKS
        if not self.seen:
            if ticks:
                self.take(ticks, 0.0)
            return
        apart = (ticks - self.lead_ticks) / self.period_ticks
        if apart < LEAST_APART:  # the answer to a doubled SYNC
            self._last = last
        elif apart < MOST_MISSED + LEAST_APART:
            self.take(ticks, max(1, round(apart)))
        else:
            self.forget()
            self._last = time_100ns
