"""PDOs: process data without a protocol (CiA 301, 7.2.2), and what a SYNC does to them (7.2.5).

| type (14xxh:02, 18xxh:02) | RPDO takes effect | TPDO is sent |
| --- | --- | --- |
| 0 | at the next SYNC | at the SYNC after an event |
| 1 to F0h | at the next SYNC | at every n-th SYNC |
| FCh | | on a remote frame, as sampled at the last SYNC |
| FDh | | on a remote frame |
| FEh, FFh | at once | at an event, not before the inhibit time, at the latest when the event timer is over |

At a SYNC everything happens in one order, so that what is sent belongs to what was received before:

1. the application says whether this SYNC counts (`accepts_sync`);
2. synchronous RPDOs that came since the last one are taken over, each with `rpdo_received`;
3. `sync_received`: the program acts on the new interval;
4. synchronous TPDOs are sampled and sent in the same call, so the window of 1007h always holds for them;
   then `tpdos_sampled`.

A type 0 or FEh TPDO is event-driven: `trigger` is the event. It is the way of every position PDO, so the
usual case, an active TPDO that no time delays, is one test and one call of its packer.

Length errors: an RPDO that is too short is dropped (EMCY 8210h), one that is too long is used as far as it
is mapped (EMCY 8220h), each reported once, until a PDO of the mapped length comes.
"""

from __future__ import annotations

from collections.abc import Callable

from canfb.cia301.codes import AbortCode, EmergencyCode, ErrorRegister, SdoAbort
from canfb.cia301.frame import Frame
from canfb.device.core import NEVER, Core, Routes, Timed
from canfb.device.od.dictionary import Entry
from canfb.device.pdo.mapping import (
    EVENT_DRIVEN,
    SYNC_REMOTE,
    SYNCHRONOUS,
    Direction,
    Layout,
    PdoParameters,
    numbers,
)

ERRORS = (EmergencyCode.RPDO_LENGTH, EmergencyCode.RPDO_LENGTH_EXCEEDED, EmergencyCode.RPDO_TIMEOUT)
"""What an RPDO of the mapped length ends."""


class Rpdo(Timed):
    """Takes data into the dictionary: at once (types FEh, FFh) or at the next SYNC (0 to F0h).

    The application is called when the data is in the dictionary, and when a PDO was dropped because it is
    too short (EMCY 8210h). One that is too long is used as far as it is mapped (EMCY 8220h).
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
        now = self._core.call.now
        self._clear_errors(now)
        self.enable(self._operational, now)
        self._core.reactions.pdo_changed()


_LARGEST_START = 240
_new = tuple.__new__  # makes a named tuple in half the time that its own constructor takes


class Tpdo(Timed):
    """Samples the dictionary and sends it.

    Type 0: at the SYNC after an event. 1 to F0h: at every type-th SYNC, from the one with the
    counter of sub-index 6 on. FCh: sampled at the SYNC, sent on a remote frame. FDh: on a remote
    frame. FEh, FFh: at an event, not more often than the inhibit time (sub-index 3, 100 us), and
    at the latest when the event timer (sub-index 5, ms) is over. A remote frame asks for a TPDO of
    any type whose COB-ID has bit 30 = 0; types FEh and FFh keep their inhibit time then, too.

    Synchronous TPDOs go out with the SYNC itself, so that the window of 1007h always holds.
    """

    def __init__(self, core: Core, number: int) -> None:
        self.deadline = NEVER
        self._core = core
        self._emit = core.emit
        self._parameters = PdoParameters(core.dictionary, number, Direction.TRANSMIT, self._written)
        self._inhibit = self._parameters.find(3)
        self._event_timer = self._parameters.find(5)
        self._start_value = self._parameters.find(6)
        self._install()
        self._operational = False
        self._layout: Layout | None = None
        self._pack: Callable[[], bytes] | None = None
        self._can_id = 0
        self._type = 0
        self._event_driven = False
        self._inhibit_s = 0.0
        self._timer_s = 0.0
        self._limited = False
        self._pack_at_once: Callable[[], bytes] | None = None  # at an event that nothing delays
        self._not_before = -NEVER
        self._timer_end = NEVER
        self._event = False
        self._waits_for_start = False
        self._pack_each_sync: Callable[[], bytes] | None = None
        self._syncs = 0
        self._sampled: bytes | None = None

    @property
    def remote_can_id(self) -> int | None:
        """The CAN-ID on which it answers remote frames now, None when it does not."""
        if self._layout is None or not self._parameters.allows_remote:
            return None
        return self._can_id

    @property
    def configured_can_id(self) -> int | None:
        """The CAN-ID it has, in any NMT state; None while it is not valid."""
        return self._parameters.can_id if self._parameters.is_valid else None

    @property
    def is_synchronous(self) -> bool:
        """Whether the TPDO acts at a SYNC now."""
        return self._layout is not None and (self._type in SYNCHRONOUS or self._type == SYNC_REMOTE)

    def enable(self, operational: bool, now: float) -> None:
        """Whether the NMT state allows PDOs. The mapping is compiled here."""
        self._operational = operational
        self._layout = self._parameters.layout() if operational else None
        self._pack = None if self._layout is None else self._layout.pack
        self._can_id = self._parameters.can_id
        self._type = self._parameters.type.value
        self._event_driven = self._layout is not None and self._type in EVENT_DRIVEN
        self._inhibit_s = _value(self._inhibit) / 10_000
        self._timer_s = _value(self._event_timer) / 1000 if self._event_driven else 0.0
        self._limited = self._inhibit_s > 0 or self._timer_s > 0
        self._pack_at_once = self._pack if self._event_driven and not self._limited else None
        if not self._inhibit_s:
            self._not_before = -NEVER
        self._timer_end = now + self._timer_s if self._timer_s else NEVER
        self._event = False
        self._waits_for_start = _value(self._start_value) > 0
        self._pack_each_sync = (
            self._pack if self._type == 1 and not (self._waits_for_start or self._limited) else None
        )
        self._syncs = 0
        self._sampled = None
        self._schedule()

    def trigger(self, now: float) -> None:
        """An event of the application; without effect while the TPDO is not active."""
        pack = self._pack_at_once
        if pack is not None:
            emit = self._emit
            emit(_new(Frame, (self._can_id, pack(), False, None)))
        elif self._event_driven:
            if self._limited and now < self._not_before:
                self._event = True
                self._schedule()
            else:
                self._send(now)
        elif self._layout is not None:
            self._event = True

    def synchronise(self, counter: int | None, now: float) -> None:
        """A SYNC, with its counter if it has one."""
        pack = self._pack_each_sync
        if pack is not None:
            emit = self._emit
            emit(_new(Frame, (self._can_id, pack(), False, None)))
        elif self._type == 0:
            if self._event:
                self._event = False
                self._send(now)
        elif self._type == SYNC_REMOTE:
            self._sampled = self._sample()
        elif self._is_turn(counter):
            self._send(now)

    def request(self, now: float) -> None:
        """A remote frame asks for the TPDO."""
        if self._type == SYNC_REMOTE:
            if self._sampled is not None:
                self._emit(Frame(self._can_id, self._sampled))
        elif self._event_driven:
            self.trigger(now)
        else:
            self._send(now)

    @property
    def is_inhibited(self) -> bool:
        """Whether an inhibit time holds it now."""
        return self._event_driven and self._inhibit_s > 0

    def sent(self, now: float) -> None:
        """The TPDO went onto the bus at `now`, later than given out: the inhibit time counts from here."""
        if self.is_inhibited:
            self._not_before = now + self._inhibit_s
            self._schedule()

    def tick(self, now: float) -> None:
        """Send what waited for the inhibit time, or what the event timer asks for."""
        timer_over = now >= self._timer_end
        if (self._event and self._event_driven) or timer_over:
            if now >= self._not_before:
                self._send(now)
            else:
                self._event = True
                self._timer_end = NEVER
                self._schedule()

    def _is_turn(self, counter: int | None) -> bool:
        if self._waits_for_start and counter is not None:
            if counter != _value(self._start_value):
                return False
            self._waits_for_start = False
            self._syncs = 0
            return True
        self._syncs += 1
        if self._syncs < self._type:
            return False
        self._syncs = 0
        return True

    def _sample(self) -> bytes:
        return b"" if self._layout is None else self._layout.pack()

    def _send(self, now: float) -> None:
        pack = self._pack
        if pack is None:
            return
        self._emit(_new(Frame, (self._can_id, pack(), False, None)))
        if self._limited:
            self._event = False
            if self._inhibit_s and self._event_driven:
                self._not_before = now + self._inhibit_s
            if self._timer_s:
                self._timer_end = now + self._timer_s
            self._schedule()

    def _schedule(self) -> None:
        waits = self._event and self._event_driven
        self.deadline = min(self._not_before if waits else NEVER, self._timer_end)

    def _install(self) -> None:
        if self._inhibit is not None:
            self._inhibit.on_check = self._parameters.refuse_while_valid
        if self._start_value is not None:
            self._start_value.on_check = self._check_start_value
        if self._event_timer is not None:
            self._event_timer.on_written = self._written

    def _check_start_value(self, value: int) -> None:
        self._parameters.refuse_while_valid(value)
        if value > _LARGEST_START:
            raise SdoAbort(AbortCode.INVALID_VALUE)

    def _written(self) -> None:
        self.enable(self._operational, self._core.call.now)
        self._core.reactions.pdo_changed()


def _value(entry: Entry | None) -> int:
    return 0 if entry is None else int(entry.value)


class Pdos:
    """The RPDOs and TPDOs, by their numbers."""

    def __init__(self, core: Core) -> None:
        self._core, self._application = core, core.application
        self.rpdos = {number: Rpdo(core, number) for number in numbers(core.dictionary, Direction.RECEIVE)}
        self.tpdos = {number: Tpdo(core, number) for number in numbers(core.dictionary, Direction.TRANSMIT)}
        self._operational = False
        self._sync_rpdos: list[Rpdo] = []
        self._sync_tpdos: list[Tpdo] = []

    def enable(self, operational: bool, now: float) -> None:
        """Whether the NMT state allows PDOs."""
        self._operational = operational
        for rpdo in self.rpdos.values():
            rpdo.enable(operational, now)
        for tpdo in self.tpdos.values():
            tpdo.enable(operational, now)

    def synchronous_rpdo(self, number: int) -> Rpdo | None:
        """RPDO `number` if it is taken over at a SYNC now, else None."""
        return next((rpdo for rpdo in self._sync_rpdos if rpdo.number == number), None)

    def add_routes(self, routes: Routes) -> None:
        """Who listens to which CAN-ID in OPERATIONAL, and who follows what leaves."""
        for rpdo in self.rpdos.values():
            routes.add(rpdo.can_id, rpdo.handle)
        for tpdo in self.tpdos.values():
            routes.add_remote(tpdo.remote_can_id, tpdo.request)
            if tpdo.is_inhibited:
                routes.add_sent(tpdo.configured_can_id, tpdo.sent)

    def choose(self) -> None:
        """Look which of them act at a SYNC, with these parameters."""
        self._sync_rpdos = [rpdo for rpdo in self.rpdos.values() if rpdo.is_synchronous]
        self._sync_tpdos = [tpdo for tpdo in self.tpdos.values() if tpdo.is_synchronous]

    def synchronise(self, counter: int | None, now: float) -> None:
        """A SYNC, with its counter if it has one: in OPERATIONAL, and if the program accepts it."""
        core, application = self._core, self._application
        if core.window_s:
            core.window_end = now + core.window_s
        if not self._operational:
            application.idle_sync_received(counter)
            return
        if not application.accepts_sync(counter, now):
            return
        for rpdo in self._sync_rpdos:
            rpdo.synchronise(now)
        application.sync_received(counter, now)
        for tpdo in self._sync_tpdos:
            tpdo.synchronise(counter, now)
        application.tpdos_sampled()
