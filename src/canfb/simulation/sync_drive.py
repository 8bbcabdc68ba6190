"""A simulated drive: it produces the SYNC and consumes the position PDO of a feedback module."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

from canfb.cia301 import cob
from canfb.cia301.frame import Frame
from canfb.simulation.sync_timing import REGULAR, SyncDeviation, SyncTiming

POSITION_PDO = struct.Struct("<IHH")  # 6004h, 2011:01 status word, 2011:02 residual


@dataclass
class Consumed:
    """What came in the position PDOs, one entry each; positions are unwrapped measuring units."""

    sync_number: list[int] = field(default_factory=list)
    position_units: list[int] = field(default_factory=list)
    status: list[int] = field(default_factory=list)
    residual_cycles: list[float] = field(default_factory=list)


class Drive:
    """SYNC producer and position consumer, sans-I/O.

    ``position_cob_id`` is the module's TPDO1; positions wrap at ``total_range`` measuring
    units and are unwrapped here: the drive moves less than half of that between two PDOs. ``timing`` makes
    the SYNC drift and jitter about its period.
    """

    def __init__(
        self,
        sync_period_s: float,
        position_cob_id: int,
        total_range: int,
        timing: SyncTiming = REGULAR,
        seed: int = 1,
    ) -> None:
        self.sync_period_s = sync_period_s
        self._deviation = SyncDeviation(timing, sync_period_s, seed)
        self.total_range = total_range
        self.syncs = 0
        self.consumed = Consumed()
        self._position_cob_id = position_cob_id
        self._start_s = 0.0
        self._next_s: float | None = None
        self._last_units: int | None = None

    def start(self, now: float) -> list[Frame]:
        """Nothing to send at power-on."""
        return []

    def start_sync(self, now: float) -> None:
        """Produce the SYNC from ``now`` (seconds) on."""
        self._start_s = self._next_s = now
        self.syncs = 0

    def deadline(self) -> float | None:
        """The time of the next SYNC."""
        return self._next_s

    def tick(self, now: float) -> list[Frame]:
        """The SYNC, when it is due."""
        if self._next_s is None or now < self._next_s:
            return []
        self.syncs += 1
        nominal_s = self._start_s + self.syncs * self._deviation.period_s
        self._next_s = max(now, nominal_s + self._deviation.next_s())
        return [Frame(cob.SYNC, b"")]

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Take the position PDO; every other frame is none of its business."""
        if frame.can_id == self._position_cob_id and len(frame.data) == POSITION_PDO.size:
            position, status, residual = POSITION_PDO.unpack(frame.data)
            consumed = self.consumed
            consumed.sync_number.append(self.syncs)
            consumed.position_units.append(self._unwrap(position))
            consumed.status.append(status)
            consumed.residual_cycles.append(residual / 65536)
        return []

    def _unwrap(self, position: int) -> int:
        last = self._last_units
        if last is None:
            self._last_units = position
        else:
            half = self.total_range // 2
            self._last_units = last + (position - last + half) % self.total_range - half
        return self._last_units
