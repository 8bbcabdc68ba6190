"""Node guarding and life guarding: 100Ch and 100Dh (CiA 301, 7.2.8.3.2.1)."""

from __future__ import annotations

from canfb.cia301.cob import ERROR_CONTROL
from canfb.cia301.codes import EmergencyCode, ErrorRegister
from canfb.cia301.frame import Frame
from canfb.device.agenda import Timed
from canfb.device.core import Core
from canfb.device.heartbeat import HeartbeatProducer
from canfb.device.moment import NEVER

_TOGGLE = 0x80
_SOURCE = 0x100C


class NodeGuarding(Timed):
    """Answers the remote frames of a master with the NMT state, and watches that they come.

    The toggle bit is 0 in the first answer after a reset, then alternates. The life time, 100Ch
    milliseconds times 100Dh, runs from the first remote frame on; 0 is none. When it is over:
    EMCY 8130h and a communication error, once; the next remote frame ends the error. There is no
    guarding while there is a `heartbeat`, nor on a device without 100Ch.
    """

    def __init__(self, core: Core, heartbeat: HeartbeatProducer) -> None:
        self.deadline = NEVER
        self._core = core
        self._can_id = ERROR_CONTROL + core.node_id
        self._emergency = core.emergency
        self._heartbeat = heartbeat
        self._guard_time = core.dictionary.find(0x100C)
        self._factor = core.dictionary.find(0x100D)
        self._toggle = 0
        self._guarded = False
        for entry in (self._guard_time, self._factor):
            if entry is not None:
                entry.on_written = self._written

    @property
    def can_id(self) -> int | None:
        """The CAN-ID on which it answers remote frames now, None when it does not."""
        return None if self._guard_time is None or self._heartbeat.is_active else self._can_id

    @property
    def life_time_s(self) -> float:
        """How long a master may be silent, seconds; 0 for any time."""
        if self._guard_time is None or self._factor is None:
            return 0.0
        return int(self._guard_time.value) * int(self._factor.value) / 1000

    def configure(self, now: float) -> None:
        """Restart: toggle bit 0, no error, no life time before the first remote frame."""
        self._toggle = 0
        self._guarded = False
        self.deadline = NEVER
        self._emergency.clear(EmergencyCode.HEARTBEAT, now, _SOURCE)

    def request(self, now: float) -> None:
        """A remote frame of the master."""
        self._core.emit(Frame(self._can_id, bytes([self._toggle | self._core.state])))
        self._toggle ^= _TOGGLE
        self._guarded = True
        self._start(now)

    def tick(self, now: float) -> None:
        """Report that the master is silent, once."""
        if now < self.deadline:
            return
        self.deadline = NEVER
        self._guarded = False  # the next remote frame starts the life time again
        self._emergency.report(EmergencyCode.HEARTBEAT, ErrorRegister.COMMUNICATION, b"", now, _SOURCE)
        self._core.reactions.communication_error("the guarding master is silent", now)

    def _start(self, now: float) -> None:
        life_time = self.life_time_s
        self.deadline = now + life_time if life_time else NEVER
        self._emergency.clear(EmergencyCode.HEARTBEAT, now, _SOURCE)

    def _written(self) -> None:
        """Another life time holds from now on; none ends an error."""
        if self._guarded or not self.life_time_s:
            self._start(self._core.moment.now)
