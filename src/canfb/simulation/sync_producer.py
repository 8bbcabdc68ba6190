"""A SYNC producer for a bus that has none."""

from __future__ import annotations

import math

from canfb.cia301 import cob
from canfb.cia301.frame import Frame
from canfb.simulation.sync_timing import REGULAR, SyncDeviation, SyncTiming


class SyncProducer:
    """Sends a SYNC each ``period_s`` seconds from power-on; sans-I/O.

    ``timing`` makes them drift and jitter about these times. When the caller comes late, the SYNCs that are
    overdue are left out, so that the bus never gets a burst of them. ValueError unless the period is
    positive.
    """

    def __init__(self, period_s: float, timing: SyncTiming = REGULAR, seed: int = 1) -> None:
        if not 0.0 < period_s < math.inf:
            raise ValueError(f"period_s must be positive, not {period_s!r}")
        self.period_s = period_s
        self._deviation = SyncDeviation(timing, period_s, seed)
        self._nominal_s = 0.0
        self._next_s: float | None = None

    def start(self, now: float) -> list[Frame]:
        """Power-on: the first SYNC comes one period later."""
        self._plan(now + self._deviation.period_s, now)
        return []

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Nothing on the bus concerns it."""
        return []

    def deadline(self) -> float | None:
        """The time of the next SYNC."""
        return self._next_s

    def tick(self, now: float) -> list[Frame]:
        """The SYNC when it is due."""
        if self._next_s is None or now < self._next_s:
            return []
        period_s = self._deviation.period_s
        late = max(0, int((now - self._nominal_s) / period_s))
        self._plan(self._nominal_s + (late + 1) * period_s, now)
        return [Frame(cob.SYNC, b"")]

    def _plan(self, nominal_s: float, now: float) -> None:
        if nominal_s <= now:
            nominal_s = now + self._deviation.period_s  # the sum may round down to now
        self._nominal_s = nominal_s
        self._next_s = max(now, nominal_s + self._deviation.next_s())
