"""A SYNC producer for a bus that has none."""

from __future__ import annotations

import math

from canfb.device.frame import Frame

SYNC_COB_ID = 0x80


class SyncProducer:
    """Sends a SYNC each ``period_s`` seconds from power-on; sans-I/O.

    When the caller comes late, the SYNCs that are overdue are left out, so that the bus
    never gets a burst of them. ValueError unless the period is positive.
    """

    def __init__(self, period_s: float) -> None:
        if not 0.0 < period_s < math.inf:
            raise ValueError(f"period_s must be positive, not {period_s!r}")
        self.period_s = period_s
        self._next_s: float | None = None

    def start(self, now: float) -> list[Frame]:
        """Power-on: the first SYNC comes one period later."""
        self._next_s = now + self.period_s
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
        late = int((now - self._next_s) / self.period_s)
        following = self._next_s + (late + 1) * self.period_s
        self._next_s = following if following > now else now + self.period_s  # the sum may round down to now
        return [Frame(SYNC_COB_ID, b"")]
