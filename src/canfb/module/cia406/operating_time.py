"""Object 6508h: how long the module has been switched on, over all its starts (CiA 406)."""

from __future__ import annotations

import struct
from collections.abc import Callable

from canfb.device.od.dictionary import Dictionary
from canfb.device.storage.image import ParameterGroup, Record
from canfb.device.storage.storage import Storage

OPERATING_TIME = 0x6508
NOT_COUNTED = 0xFFFFFFFF
UNIT_S = 360  # 0.1 h
LEAST_S = 60  # of another time that is worth writing
_SECONDS = struct.Struct("<Q")


class OperatingTime:
    """Counts from the first :meth:`begin` on, beyond what the store has kept.

    Writing takes milliseconds, in which a store that does not write in the background answers no SYNC. So
    :meth:`keep` is for moments in which none has to be, and what has passed since the last one is lost with
    the power. Without a store the time is not counted: 6508h reads FFFFFFFFh. ``now()`` is the time of the
    running call.
    """

    def __init__(self, dictionary: Dictionary, storage: Storage, now: Callable[[], float]) -> None:
        self._storage = storage
        self._now = now
        self._since_s: float | None = None  # power-on
        self._before_s = self._kept_s = 0
        dictionary.entry(OPERATING_TIME).on_read = self._tenths

    def begin(self, now: float) -> None:
        """Power-on at ``now`` (seconds); a reset is none, and changes nothing."""
        if self._since_s is not None or not self._storage.is_there:
            return
        self._since_s = now
        records = self._storage.records(ParameterGroup.OPERATING_TIME)
        if records is None:
            return
        data = {(record.index, record.subindex): record.data for record in records}.get((OPERATING_TIME, 0))
        if data is None or len(data) != _SECONDS.size:
            self._storage.refuse(ParameterGroup.OPERATING_TIME, "it contains no time")
            return
        self._before_s = self._kept_s = _SECONDS.unpack(data)[0]

    def keep(self, now: float) -> None:
        """Into the store, if a minute has passed. A disk that fails is tried again next time."""
        seconds = self._seconds(now)
        if seconds - self._kept_s < LEAST_S:
            return
        record = Record(OPERATING_TIME, 0, False, _SECONDS.pack(seconds))

        def done(error: OSError | None) -> None:
            if error is None:
                self._kept_s = seconds

        self._storage.save_records(ParameterGroup.OPERATING_TIME, [record], done)

    def _seconds(self, now: float) -> int:
        since = now if self._since_s is None else self._since_s
        return self._before_s + max(0, int(now - since))

    def _tenths(self) -> int:
        if self._since_s is None:
            return NOT_COUNTED
        return min(self._seconds(self._now()) // UNIT_S, NOT_COUNTED - 1)
