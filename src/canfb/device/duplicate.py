"""Another node with the same node-ID: what it sends gives it away."""

from __future__ import annotations

from canfb.cia301.codes import EmergencyCode, ErrorRegister
from canfb.device.core import Core
from canfb.device.routing import Handler

_SOURCE = "duplicate node-ID"


class DuplicateWatch:
    """Listens to the CAN-IDs that this node alone may send.

    A CAN controller does not hear itself, so a data frame there comes from another node: one that
    was given the same node-ID, or the same COB-ID (CiA 301, 7.3.5: a CAN-ID has one sender). Each
    is counted. The first after a reset gives EMCY 8150h, with the CAN-ID in bytes 3 and 4, and is
    reported to the program. The NMT state stays: a single stray frame must not stop a machine.
    """

    def __init__(self, core: Core) -> None:
        self._counters = core.counters
        self._emergency = core.emergency
        self._application = core.application
        self._reported = False

    def reset(self) -> None:
        """Report again, after an NMT reset."""
        self._reported = False

    def handler(self, can_id: int) -> Handler:
        """Who takes the data frames with this CAN-ID."""

        def handle(data: bytes, now: float) -> None:
            self._counters.duplicate_frames += 1
            if not self._reported:
                self._reported = True
                self._report(can_id, now)

        return handle

    def _report(self, can_id: int, now: float) -> None:
        self._emergency.report(
            EmergencyCode.CAN_ID_COLLISION,
            ErrorRegister.COMMUNICATION,
            can_id.to_bytes(2, "little"),
            now,
            _SOURCE,
        )
        self._application.duplicate_received(can_id, now)
