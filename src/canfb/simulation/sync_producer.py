"""A SYNC producer for a bus that has none."""

from __future__ import annotations

from canfb.device.frame import Frame

SYNC_COB_ID = 0x80


class SyncProducer:
    """Sends a SYNC each ``period_s`` seconds from power-on; sans-I/O.

    When the caller comes late, the SYNCs that are overdue are left out, so that the bus
    never gets a burst of them.
    """

    def __init__(self, period_s: float) -> None:
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
        self._next_s += (late + 1) * self.period_s
        return [Frame(SYNC_COB_ID, b"")]
