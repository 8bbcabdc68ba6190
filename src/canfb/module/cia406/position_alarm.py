"""EMCY 7300h: the position is not valid (CiA 406, 6503h bit 0).

Its five bytes: the status word 2011:01 (2), the cause of the loss as 2012:10 (1), 2012:12 up to 255 (1), 0.
The cause is 0 until the position is lost; a loss that comes later is reported with an EMCY of its own.
"""

from __future__ import annotations

from canfb.cia301.codes import EmergencyCode, ErrorRegister
from canfb.device.core import NEVER
from canfb.device.node import Node
from canfb.module.objects.last_loss import LastLoss
from canfb.signal.supervision import LOST

REGISTER = ErrorRegister.GENERIC | ErrorRegister.DEVICE_PROFILE
SHORTEST_S = 0.1  # from one end of the alarm to the next: ten pairs of EMCY a second at most


class PositionAlarm:
    """Reports the alarm at once, and its end unless there was another one just before."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self.reset()

    def reset(self) -> None:
        """After an NMT reset no error is active."""
        self.active = self._said_lost = False
        self._ended_s = -NEVER

    def report(self, valid: bool, status: int, now: float, loss: LastLoss) -> None:
        """The position is ``valid`` or not; ``status`` is the status word, ``loss`` the last loss."""
        if not valid:
            lost = bool(status & LOST) and not self._said_lost
            if lost or not self.active:
                self.active, self._said_lost = True, lost
                why = bytes((int(loss.cause), min(loss.bad_samples, 0xFF))) if lost else b""
                detail = status.to_bytes(2, "little") + why
                self._node.emergency(EmergencyCode.SENSOR, REGISTER, detail, now, again=lost)
        elif now - self._ended_s >= SHORTEST_S:
            self.active = self._said_lost = False
            self._ended_s = now
            self._node.clear_emergency(EmergencyCode.SENSOR, now)
