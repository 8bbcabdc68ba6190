"""A CANopen slave (CiA 301) without I/O: frames and times in, frames and the next deadline out.

    out  = node.start(now)             power-on: the boot-up
    out  = node.receive(frame, now)    each frame of the bus, in order
    out  = node.tick(now)              at the `deadline` or later
    when = node.deadline()             seconds, or None

A host sends `out`, in order, before it calls again. `receive` routes a frame by its CAN-ID to a service. A
frame never raises: without a listener it is counted. Exceptions of the application reach the caller.

`now` is monotonic, seconds; `frame.timestamp`, on the same clock and no later, is the receive time.

A host requires :class:`Device` of a node, and uses the protocols below it if the node has them.
:class:`NodeDevice`, a node that is its own application, has all but `Computing`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any, Protocol, runtime_checkable

from canfb import checks
from canfb.cia301.codes import EmergencyCode, ErrorRegister, NmtState
from canfb.cia301.frame import HIGHEST_ID, LONGEST_DATA, Frame
from canfb.device.core import NEVER, Application, CanIds, Expiry, Groups
from canfb.device.life_cycle import LifeCycle
from canfb.device.lss import REQUEST_ID, UNCONFIGURED, is_node_id
from canfb.device.od.dictionary import Dictionary
from canfb.device.pdo.rpdo import Rpdo
from canfb.device.sdo.server import TIMEOUT_S
from canfb.device.storage.kept import ParameterGroup
from canfb.device.storage.storage import Store

_BUS = "bus"


class _NeverExpires:
    """Process data that is always valid."""

    until = NEVER


class Node:
    """A CiA 301 slave without I/O, which notifies its `application` of events.

    With the node-ID 255 it answers LSS only, until a master assigns one. A stored node-ID takes precedence.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        node_id: int,
        application: Application | None = None,
        *,
        expiry: Expiry | None = None,
        autostart: bool = False,
        sdo_timeout_s: float = TIMEOUT_S,
        store: Store | None = None,
        bit_rates_kbit_s: Collection[int] = (),
    ) -> None:
        """Make the node `node_id` (1..127, 255); ValueError for another, or for an impossible EDS.

        `expiry` limits the validity of the process data. With `autostart` bit 2 of 1F80h is 0 by default.
        `sdo_timeout_s` is how long an SDO client may be silent, > 0 s. `store` keeps what 1010h and LSS save.
        LSS may select one of `bit_rates_kbit_s`.
        """
        if not is_node_id(node_id):
            raise ValueError(f"node-ID {node_id} is out of range; use 1 to 127, or 255 for none yet")
        if not 0 < sdo_timeout_s < NEVER:
            raise ValueError(f"sdo_timeout_s is {sdo_timeout_s}; give a time in seconds, more than 0")
        self._application = Application() if application is None else application
        # A module passes its `SyncJudge`: each SYNC postpones `until`.
        self._expiry: Expiry = _NeverExpires() if expiry is None else expiry
        self._life = life = LifeCycle(
            dictionary,
            node_id,
            self._application,
            autostart=autostart,
            sdo_timeout_s=sdo_timeout_s,
            store=store,
            bit_rates_kbit_s=bit_rates_kbit_s,
        )
        self._core = core = life.core
        self.dictionary = dictionary
        self.storage = life.storage
        self.lss = life.lss
        self.counters = core.counters
        self.call = core.call  # The times of the running call.
        # Used for every frame: bound once, to save attribute look-ups.
        self._agenda = core.agenda
        self._outbox = core.outbox
        self._routes, self._remote_routes = core.routes.data, core.routes.remote
        self._silence = life.silence
        # The callbacks of `sent`, by CAN-ID; the same mapping for the life of the node.
        self.inhibited = core.routes.sent

    @property
    def node_id(self) -> int:
        return self._core.node_id

    def node_id_at_power_on(self) -> int:
        """The node-ID of the next :meth:`start`: the one that LSS stored, else the one of the program."""
        return self._life.node_id_at_power_on()

    @property
    def state(self) -> NmtState:
        return self._core.state

    @property
    def own_can_ids(self) -> frozenset[int]:
        return frozenset() if self.node_id == UNCONFIGURED else self._life.services.own_can_ids()

    @property
    def route_changes(self) -> int:
        return self._core.routes.changes

    @property
    def received_can_ids(self) -> frozenset[int]:
        """CAN-IDs of data frames with a listener now, without its own."""
        return frozenset(self._routes) - self.own_can_ids

    def can_ids(self) -> CanIds:
        if self.node_id == UNCONFIGURED:
            return CanIds(frozenset({REQUEST_ID}), frozenset())
        return self._life.services.can_ids()

    def follow_can_ids(self, moved: Callable[[], None]) -> None:
        """Have ``moved`` called when :meth:`can_ids` may change."""
        self._core.routes.on_change = moved

    @property
    def now(self) -> float:
        return self.call.now

    def start(self, now: float) -> list[Frame]:
        self.call.now = now
        self._life.power_on(now)
        return self._sent()

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Process a frame from the bus; returns the frames to be sent.

        A late caller first passes all waiting frames, in order, and then calls `tick`.
        """
        call = self.call
        call.now = now
        can_id, data, rtr, timestamp = frame
        if now > self._expiry.until and (timestamp is None or timestamp > self._expiry.until):
            self._application.expired(now)
        if timestamp is None:
            call.received, call.is_stamped = now, False
        elif call.stamp <= timestamp <= now:  # as usual: later than the last
            call.received = call.stamp = timestamp
            call.is_stamped = True
        else:
            call.stamped(timestamp)
        handler = self._routes.get(can_id)
        if handler is not None and not rtr and len(data) <= LONGEST_DATA:
            handler(data, now)
        else:
            self._receive_other(can_id, data, rtr, now)
        outbox = self._outbox
        if not outbox:
            return []
        sent = [] if self._silence.active else outbox[:]
        outbox.clear()
        return sent

    def tick(self, now: float, until: float = NEVER) -> list[Frame]:
        """Do what was due at ``until``, by default ``now``: frames received after it may still wait.

        ValueError if ``now`` is not finite.
        """
        checks.number("now", now)
        until = min(now, until)
        call = self.call
        call.now = call.received = now
        call.is_stamped = True  # a SYNC that the node produces in this tick is sent at `now`
        if until >= self._expiry.until:
            self._application.overdue(until)
        self._agenda.tick(now, until)
        return self._sent()

    def deadline(self) -> float | None:
        if self._outbox:
            return self.call.now
        agenda, until = self._agenda, self._expiry.until
        due = agenda.due() if agenda.moved else agenda.earliest
        if until < due:
            return until
        return None if due == NEVER else due

    def sent(self, can_id: int, now: float) -> None:
        """A frame of the node with this CAN-ID left at `now`: its inhibit time starts."""
        follow = self.inhibited.get(can_id)
        if follow is not None:
            follow(now)

    def rpdo_with(self, *objects: tuple[int, int]) -> int | None:
        rpdos = self._life.services.pdos.rpdos
        return next((number for number, rpdo in rpdos.items() if rpdo.holds(objects)), None)

    def synchronous_rpdo(self, number: int) -> Rpdo | None:
        rpdos = self._life.services.pdos.sync_rpdos
        return next((rpdo for rpdo in rpdos if rpdo.number == number), None)

    def trigger_tpdo(self, number: int, now: float) -> None:
        """An event for TPDO `number`. Types FEh and FFh are sent at once or after the inhibit time, type 0
        at the next SYNC.

        ValueError if the device has no such TPDO.
        """
        self.call.now = now
        tpdos = self._life.services.pdos.tpdos
        if number not in tpdos:
            raise ValueError(f"there is no TPDO {number}; the EDS has {sorted(tpdos)}")
        tpdos[number].at_event(now)

    def event_tpdos(self) -> list[Callable[[float], None]]:
        """Events for the TPDOs that take them, until `configuration_changed`."""
        return [tpdo.at_event for tpdo in self._life.services.pdos.tpdos.values() if tpdo.takes_events]

    def emergency(
        self,
        code: int,
        register_bits: int,
        manufacturer: bytes = b"",
        now: float | None = None,
        *,
        again: bool = False,
    ) -> None:
        """Report an error (CiA 301, 7.2.7) in EMCY, 1001h and 1003h; an active error only with `again`.

        `register_bits` are bits of 1001h (0..255), `manufacturer` up to 5 bytes; `now` defaults to the time
        of the running call. ValueError outside these ranges.
        """
        if not 0 <= register_bits <= 0xFF:
            raise ValueError(f"register_bits {register_bits:#x} do not fit the 8 bits of 1001h")
        if len(manufacturer) > 5:
            raise ValueError(f"an EMCY has 5 manufacturer bytes, not {len(manufacturer)}")
        if not 0 < code <= 0xFFFF:
            raise ValueError(f"{code:#x} is not an error code; use clear_emergency to end an error")
        self._core.emergency.report(code, register_bits, manufacturer, self._at(now), again=again)

    def clear_emergency(self, code: int, now: float | None = None) -> None:
        self._core.emergency.clear(code, self._at(now))

    def bus_off(self, now: float) -> list[Frame]:
        self.call.now = now
        self._life.communication_error("the bus is gone", now)
        return self._sent()

    def bus_back(self, now: float) -> list[Frame]:
        """Send EMCY 8140h, then 0000h; keep the NMT state."""
        self.call.now = now
        if self._core.state is not NmtState.INITIALISING:
            code, emergency = EmergencyCode.BUS_OFF_RECOVERED, self._core.emergency
            emergency.report(code, ErrorRegister.COMMUNICATION, b"", now, _BUS)
            emergency.clear(code, now, _BUS)
        return self._sent()

    def _at(self, now: float | None) -> float:
        if now is not None:
            self.call.now = now
        return self.call.now

    def _sent(self) -> list[Frame]:
        sent = [] if self._silence.active else self._outbox[:]
        self._outbox.clear()
        return sent

    def _receive_other(self, can_id: int, data: bytes, rtr: bool, now: float) -> None:
        if rtr:
            handler = self._remote_routes.get(can_id)
            if handler is None:
                self.counters.remote_frames += 1
            else:
                handler(now)
        elif len(data) > LONGEST_DATA or not 0 <= can_id <= HIGHEST_ID:
            self.counters.malformed_frames += 1
        else:
            self.counters.unknown_cob_ids += 1


class Device(Protocol):
    """A sans-I/O device. Times in seconds, monotonic."""

    def start(self, now: float) -> list[Frame]:
        """Power-on at ``now``."""

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Take a frame of another device."""

    def tick(self, now: float, until: float = NEVER) -> list[Frame]:
        """Do what was due at ``until``."""

    def deadline(self) -> float | None:
        """When tick is due."""


@runtime_checkable
class Selective(Protocol):
    """A device that lists the CAN-IDs it receives."""

    def can_ids(self) -> CanIds:
        """The CAN-IDs received."""

    def follow_can_ids(self, moved: Callable[[], None]) -> None:
        """Call ``moved`` when they change."""


@runtime_checkable
class Ending(Protocol):
    """A device that acts when the program ends."""

    def end(self, now: float) -> None:
        """The program ends."""


@runtime_checkable
class Inhibited(Protocol):
    """A device whose inhibit times start when its frames leave."""

    inhibited: Mapping[int | None, object]  # By CAN-ID: the frames for which ``sent`` is called.

    def sent(self, can_id: int, now: float) -> None:
        """A frame of the device has left."""


@runtime_checkable
class BusWatching(Protocol):
    """A device that is notified of bus failures."""

    def bus_off(self, now: float) -> list[Frame]:
        """The bus is gone."""

    def bus_back(self, now: float) -> list[Frame]:
        """The bus is back."""


@runtime_checkable
class Computing(Protocol):
    """A device with occasional long computations."""

    def pending_job(self) -> Any:
        """The pending computation, or None."""

    def finish_job(self, job: Any, result: Any, now: float) -> list[Frame]:
        """Take the result, or an Exception."""

    def job_progress(self, job: Any, part: float) -> None:
        """Progress, 0..1."""


class NodeDevice(Node, Application):
    """A node that is its own application: base of FeedbackModule and EncoderInterface.

    The host program may set ``on_parameter_faults`` (groups of stored parameters that were refused,
    and why), ``on_duplicate`` (can_id, now) and ``on_bit_rate`` (kbit_s, delay_s, now), see
    :meth:`Application.bit_rate_activated`.
    """

    register_bits = ErrorRegister.GENERIC  # Bits of 1001h while stored parameters are refused.

    def __init__(
        self,
        dictionary: Dictionary,
        node_id: int,
        *,
        autostart: bool,
        store: Store | None,
        bit_rates_kbit_s: Collection[int],
        expiry: Expiry | None = None,
    ) -> None:
        super().__init__(
            dictionary,
            node_id,
            self,
            expiry=expiry,
            autostart=autostart,
            store=store,
            bit_rates_kbit_s=bit_rates_kbit_s,
        )
        self.observer = Application()  # Also notified of NMT state, EMCY and saved parameters.
        self.on_parameter_faults: Callable[[Mapping[ParameterGroup, str]], None] = lambda faults: None
        self.on_duplicate: Callable[[int, float], None] = lambda can_id, now: None
        self.on_bit_rate: Callable[[int, float, float], None] = lambda kbit_s, delay_s, now: None

    # Application: called by the node.

    def state_changed(self, old: NmtState, new: NmtState, now: float, why: str) -> None:
        self.observer.state_changed(old, new, now, why)

    def emergency_sent(self, code: int, register: int, detail: bytes, now: float) -> None:
        self.observer.emergency_sent(code, register, detail, now)

    def parameters_saved(self, saved: Groups, forgotten: Groups, now: float) -> None:
        self.observer.parameters_saved(saved, forgotten, now)

    def saving_failed(self, groups: Groups, reason: str, now: float) -> None:
        self.observer.saving_failed(groups, reason, now)

    def parameters_refused(self, faults: Mapping[ParameterGroup, str], now: float) -> None:
        """Report EMCY 6310h with the groups, and call `on_parameter_faults`."""
        if faults:
            groups = bytes(sorted(faults))[:5]
            self.emergency(EmergencyCode.DATA_SET, self.register_bits, groups, now)
        else:
            self.clear_emergency(EmergencyCode.DATA_SET, now)
        self.on_parameter_faults(faults)

    def duplicate_received(self, can_id: int, now: float) -> None:
        self.on_duplicate(can_id, now)

    def bit_rate_activated(self, kbit_s: int, delay_s: float, now: float) -> None:
        self.on_bit_rate(kbit_s, delay_s, now)
