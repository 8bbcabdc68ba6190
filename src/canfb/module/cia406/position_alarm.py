"""EMCY 7300h: the position is not valid (CiA 406, 6503h bit 0)."""

from __future__ import annotations

from canfb.cia301.codes import EmergencyCode, ErrorRegister
from canfb.device.moment import NEVER
from canfb.device.node import Node

REGISTER = ErrorRegister.GENERIC | ErrorRegister.DEVICE_PROFILE
SHORTEST_S = 0.1  # from one end of the alarm to the next: ten pairs of EMCY a second at most


class PositionAlarm:
    """Reports the alarm at once, and its end unless there was another one just before."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self.reset()

    def reset(self) -> None:
        """After an NMT reset no error is active."""
        self.active = False
        self._ended_s = -NEVER

    def report(self, valid: bool, status: int, now: float) -> None:
        """The position is ``valid`` or not; ``status`` is the status word that says why."""
        if not valid:
            self.active = True
            detail = status.to_bytes(2, "little")
            self._node.emergency(EmergencyCode.SENSOR, REGISTER, detail, now)
        elif now - self._ended_s >= SHORTEST_S:
            self.active = False
            self._ended_s = now
            self._node.clear_emergency(EmergencyCode.SENSOR, now)
