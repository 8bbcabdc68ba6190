"""How long it is from one SYNC to the next."""

from __future__ import annotations

SMOOTHING = 1.0 / 32.0
SAME_RATE = 1.5  # a time longer or shorter by more than this factor is an exception, or a new rate
EXCEPTIONS = 8  # this many in a row are a new rate


class SyncInterval:
    """The mean time between two SYNCs, ``seconds``: 0.0 before the second one.

    Pauses, and SYNCs that are heard late, are left out. ``last_s`` is when the last one was heard.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self.last_s: float | None = None
        self._exceptions: list[float] = []

    def event(self, now: float) -> None:
        """A SYNC at ``now``, seconds."""
        last, self.last_s = self.last_s, now
        if last is None or now <= last:
            return
        interval = now - last
        if self.seconds == 0.0:
            self.seconds = interval
        elif self.seconds / SAME_RATE < interval < SAME_RATE * self.seconds:
            self.seconds += (interval - self.seconds) * SMOOTHING
            self._exceptions.clear()
        else:
            self._exceptions.append(interval)
            if len(self._exceptions) == EXCEPTIONS:
                self.seconds = sum(self._exceptions) / EXCEPTIONS
                self._exceptions.clear()
