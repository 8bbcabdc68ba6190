"""The nominal SYNC: when a SYNC without jitter would have come, by the clock of the encoder interface."""

from __future__ import annotations

import itertools
import statistics

from canfb.signal.sample_times import TICKS

MEMORY_SYNCS = 256  # that the lock remembers, about
LEARNED_SYNCS = 64  # from then on it is used
FIRST_SYNCS = 16  # distances, for the first straight line
LEAST_APART = 0.5  # of the period
MOST_MISSED = 16  # from one sample to the next: beyond that the clock was started again


class NominalSync:
    """Locks on sample times (2000:05) as the timer of a drive locks on SYNC.

    An alpha-beta filter with the gains of a straight line fitted to all sample times so far, held at
    those of ``memory_syncs`` of them. With 256 the jitter of the SYNC is left with 0.11 of its rms value,
    the drift of the clock with nothing.

    ``lead_ticks`` is how much later than the last sample its nominal SYNC was, ``period_ticks`` from
    one nominal SYNC to the next; both in 100 ns of the interface's clock.
    """

    def __init__(self, memory_syncs: int = MEMORY_SYNCS) -> None:
        self._memory_syncs = memory_syncs
        self.forget()

    def forget(self) -> None:
        """Lock on the next samples."""
        self._last: int | None = None
        self._seen = 0  # samples that the lock stands on
        self._first: list[int] = []  # the first distances, ticks
        self.lead_ticks = 0.0
        self.period_ticks = 0.0

    @property
    def seen(self) -> int:
        """Samples that the lock stands on; it remembers no more than ``memory_syncs``."""
        return self._seen

    @property
    def locked(self) -> bool:
        """The lock is good enough to be used."""
        return self._seen >= LEARNED_SYNCS

    def sample(self, time_100ns: int) -> None:
        """A valid sample was taken at this time, 0 .. 2^32 - 1."""
        last = self._last
        if last is None:
            self._last = time_100ns
            return
        ticks = (time_100ns - last) % TICKS
        if self._seen and ticks - self.lead_ticks < LEAST_APART * self.period_ticks:
            return  # the answer to a doubled SYNC
        self._last = time_100ns
        if not self._seen:
            self._begin(ticks)
            return
        syncs = round((ticks - self.lead_ticks) / self.period_ticks)
        if not 1 <= syncs <= MOST_MISSED:
            self.forget()
            self._last = time_100ns
            return
        lead = self.lead_ticks + syncs * self.period_ticks - ticks
        self._seen = n = min(self._seen + 1, self._memory_syncs)
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
        if abs(lead) <= 0.5 * line.slope:
            self.period_ticks, self.lead_ticks = line.slope, lead
        else:  # these times are not those of a SYNC
            self.period_ticks, self.lead_ticks = float(usual), 0.0
        self._seen = FIRST_SYNCS + 1
