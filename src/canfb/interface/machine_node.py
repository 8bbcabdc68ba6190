"""A node beside a machine."""

from __future__ import annotations

from canfb.cia301.frame import Frame
from canfb.device.device_protocol import NodeDevice
from canfb.interface.sample_instants import TRUE_TIME, TimeBase


class MachineNode(NodeDevice):
    """``received_s``: when the frame was received that is handled now, in the time of the machine."""

    time_base: TimeBase = TRUE_TIME
    received_s = 0.0

    def machine_now(self) -> float:
        return self.time_base.at(self.now)

    def start(self, now: float) -> list[Frame]:
        self.received_s = self.time_base.at(now)
        return super().start(now)

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        self.call.now = now
        self.received_s = self.time_base.received_at(frame, now)
        self.overhear(frame)
        return super().receive(frame, now)

    def tick(self, now: float) -> list[Frame]:
        self.call.now = now
        self.received_s = self.time_base.at(now)
        self.time_passed()
        return super().tick(now)

    def overhear(self, frame: Frame) -> None:
        """Before :meth:`receive`."""

    def time_passed(self) -> None:
        """Before a tick."""
