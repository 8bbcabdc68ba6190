"""TIME consumer: 1012h (CiA 301, 7.2.6)."""

from __future__ import annotations

from canfb.cia301 import cob
from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.device.core import Core

MILLISECONDS_PER_DAY = 86_400_000
CONSUME = 1 << 31
"""Bit 31 of 1012h: the device listens to TIME."""
PRODUCE = 1 << 30
"""Bit 30 of 1012h: the device sends TIME, which this one cannot."""

_LENGTH = 6
_MILLISECONDS = 0x0FFFFFFF


class TimeStamp:
    """Takes the time of day to the program: days since 1984-01-01, and milliseconds.

    A TIME of another length than 6 bytes, or with more milliseconds than a day has, is dropped and
    counted.
    """

    def __init__(self, core: Core) -> None:
        self._entry = entry = core.dictionary.find(0x1012)
        self._counters = core.counters
        self._application = core.application
        if entry is not None:
            entry.on_check = lambda value: _check(value, entry.value)
            entry.on_written = core.reactions.routes_changed

    @property
    def can_id(self) -> int | None:
        """The CAN-ID that it listens to now, None when it does not."""
        if self._entry is None or not self._entry.value & CONSUME:
            return None
        return int(self._entry.value & cob.CAN_ID)

    def handle(self, data: bytes, now: float) -> None:
        """A TIME from the bus."""
        milliseconds = int.from_bytes(data[:4], "little") & _MILLISECONDS
        if len(data) != _LENGTH or milliseconds >= MILLISECONDS_PER_DAY:
            self._counters.malformed_frames += 1
            return
        self._application.time_received(int.from_bytes(data[4:], "little"), milliseconds, now)


def _check(value: int, old: int) -> None:
    if value & PRODUCE or cob.is_restricted(value & cob.CAN_ID):
        raise SdoAbort(AbortCode.INVALID_VALUE)
    cob.check(value, old, uses_new=bool(value & CONSUME), uses_old=bool(old & CONSUME))
