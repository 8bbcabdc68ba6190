"""How long it is from one SYNC to the next."""

from __future__ import annotations

SMOOTHING = 1.0 / 32.0
SAME_RATE = 1.5  # a time longer than this multiple is a gap, not a new rate
GAPS = 8  # so many in a row are a slower SYNC


class SyncInterval:
    """The mean time between two SYNCs, in seconds: 0.0 before the second one. Gaps are left out."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self.last_s: float | None = None
        self._gaps = 0

    def event(self, now: float) -> None:
        """A SYNC at ``now``, seconds."""
        last, self.last_s = self.last_s, now
        if last is None or now <= last:
            return
        interval = now - last
        if self.seconds == 0.0:
            self.seconds = interval
        elif interval < SAME_RATE * self.seconds:
            self.seconds += (interval - self.seconds) * SMOOTHING
            self._gaps = 0
        else:
            self._gaps += 1
            if self._gaps >= GAPS:
                self.seconds, self._gaps = interval, 0
