"""One receive PDO (CiA 301, 7.2.2)."""

from __future__ import annotations

from canfb.cia301.codes import EmergencyCode, ErrorRegister
from canfb.device.agenda import Timed
from canfb.device.core import Core
from canfb.device.moment import NEVER
from canfb.device.pdo.mapping import Direction, Layout
from canfb.device.pdo.pdo import SYNCHRONOUS, PdoParameters

ERRORS = (EmergencyCode.RPDO_LENGTH, EmergencyCode.RPDO_LENGTH_EXCEEDED, EmergencyCode.RPDO_TIMEOUT)
"""What an RPDO of the mapped length ends."""


class Rpdo(Timed):
    """Takes data into the dictionary: at once (types FEh, FFh) or at the next SYNC (0 to F0h).

    The application hears of it when the data is in the dictionary, and of a PDO that was dropped because
    it is too short (EMCY 8210h). One that is too long is used as far as it is mapped (EMCY 8220h).
    Sub-index 5 is the time-out in milliseconds: it runs from the first PDO on and gives EMCY 8250h.
    Each error is reported once; a PDO of the mapped length ends it.
    """

    def __init__(self, core: Core, number: int) -> None:
        self.number = number
        self.deadline = NEVER
        self._core = core
        self._application = core.application
        self._counters = core.counters
        self._emergency = core.emergency
        self._parameters = PdoParameters(core.dictionary, number, Direction.RECEIVE, self._written)
        self._timeout = self._parameters.find(5)
        if self._timeout is not None:
            self._timeout.on_written = self._written
        self._operational = False
        self._layout: Layout | None = None
        self._timeout_s = 0.0
        self.is_synchronous = False
        self._failed = False
        self._supervised = False
        self._pending: bytes | None = None
        self.waiting = 0
        """PDOs of a synchronous type that came since the last SYNC; the last one is taken over."""

    @property
    def can_id(self) -> int | None:
        """The CAN-ID it listens to now, None while it is not active."""
        return None if self._layout is None else self._parameters.can_id

    @property
    def configured_can_id(self) -> int | None:
        """The CAN-ID it has, in any NMT state; None while it is not valid."""
        return self._parameters.can_id if self._parameters.is_valid else None

    def enable(self, operational: bool, now: float) -> None:
        """Whether the NMT state allows PDOs. The mapping is compiled here."""
        self._operational = operational
        self._layout = self._parameters.layout() if operational else None
        self.is_synchronous = self._parameters.type.value in SYNCHRONOUS
        self._timeout_s = 0.0 if self._timeout is None else self._timeout.value / 1000
        self._pending, self.waiting = None, 0
        self.deadline = NEVER
        self._supervised = self._failed or self._timeout_s > 0

    def handle(self, data: bytes, now: float) -> None:
        """The PDO from the bus."""
        layout = self._layout
        if layout is None:
            return
        if len(data) != layout.length:
            if len(data) < layout.length:
                self._refuse(len(data), layout.length, now)
                return
            self._accept_long(len(data), layout.length, now)
        elif self._supervised:
            self._supervise(now)
        if self.is_synchronous:
            self._keep(data, now)
            return
        unpack = layout.unpack
        refused = unpack(data)
        if refused:
            self._counters.refused_rpdo_values += refused
        self._application.rpdo_received(self.number, now)

    def synchronise(self, now: float) -> None:
        """Take over what came since the last SYNC."""
        data, layout = self._pending, self._layout
        self.waiting = 0
        if data is not None and layout is not None:
            self._pending = None
            self._counters.refused_rpdo_values += layout.unpack(data)
            self._application.rpdo_received(self.number, now)

    def tick(self, now: float) -> None:
        """Report that the PDO did not come in time, once."""
        if now >= self.deadline:
            self.deadline = NEVER
            self._report(EmergencyCode.RPDO_TIMEOUT, bytes([self.number & 0xFF]), now)

    def _keep(self, data: bytes, now: float) -> None:
        """Until the next SYNC."""
        if now <= self._core.window_end:
            self._pending = data
            self.waiting += 1
        else:
            self._counters.late_rpdos += 1

    def _refuse(self, received: int, mapped: int, now: float) -> None:
        self._counters.short_rpdos += 1
        self._report(EmergencyCode.RPDO_LENGTH, bytes([self.number & 0xFF, received, mapped]), now)
        self._clear(EmergencyCode.RPDO_LENGTH_EXCEEDED, now)
        self._application.rpdo_too_short(self.number, received, mapped, now)

    def _accept_long(self, received: int, mapped: int, now: float) -> None:
        """The data is there, and in time; only its length is an error."""
        self._counters.long_rpdos += 1
        self._report(EmergencyCode.RPDO_LENGTH_EXCEEDED, bytes([self.number & 0xFF, received, mapped]), now)
        self._clear(EmergencyCode.RPDO_LENGTH, now)
        self._clear(EmergencyCode.RPDO_TIMEOUT, now)
        self._restart_timeout(now)

    def _report(self, code: EmergencyCode, manufacturer: bytes, now: float) -> None:
        self._failed = self._supervised = True
        self._emergency.report(code, ErrorRegister.COMMUNICATION, manufacturer, now, self._source)

    def _supervise(self, now: float) -> None:
        """A good PDO: errors are over, the time-out restarts."""
        if self._failed:
            self._clear_errors(now)
            self._supervised = self._timeout_s > 0
        self._restart_timeout(now)

    def _restart_timeout(self, now: float) -> None:
        self.deadline = now + self._timeout_s if self._timeout_s else NEVER

    def _clear_errors(self, now: float) -> None:
        self._failed = False
        for code in ERRORS:
            self._clear(code, now)

    def _clear(self, code: EmergencyCode, now: float) -> None:
        self._emergency.clear(code, now, self._source)

    @property
    def _source(self) -> tuple[str, int]:
        return "RPDO", self.number

    def _written(self) -> None:
        now = self._core.moment.now
        self._clear_errors(now)
        self.enable(self._operational, now)
        self._core.reactions.pdo_changed()
