"""SYNCs that were sent and not heard here, by the SYNC counter (CiA 301, 1019h)."""

from __future__ import annotations

from canfb.device.dictionary import Dictionary

COUNTER_OVERFLOW = 0x1019


class SyncGaps:
    """Counts them: each is a sample of which nothing is known. Without the counter there is no telling."""

    def __init__(self, dictionary: Dictionary) -> None:
        self._overflow = dictionary.entry(COUNTER_OVERFLOW)
        self._last: int | None = None

    def forget(self) -> None:
        """The next SYNC begins."""
        self._last = None

    def lost(self, counter: int) -> int:
        """How many, at least, between the SYNC before and the one with this counter, 1..1019h."""
        last, self._last = self._last, counter
        overflow = int(self._overflow.value)
        return 0 if last is None or overflow == 0 else (counter - last - 1) % overflow
