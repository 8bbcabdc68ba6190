"""The CANopen slave: wires the services and routes frames to them."""

from __future__ import annotations

from collections.abc import Callable, Collection

from canfb.cia301.codes import EmergencyCode, ErrorRegister
from canfb.cia301.frame import HIGHEST_ID, LONGEST_DATA, Frame
from canfb.cia301.nmt import NmtState
from canfb.device.agenda import Agenda
from canfb.device.counters import Counters
from canfb.device.emergency import check_error
from canfb.device.hooks import Hooks
from canfb.device.lss.lss import REQUEST_ID, UNCONFIGURED, LssSlave, is_node_id
from canfb.device.moment import NEVER, Moment
from canfb.device.nmt_slave import Startup
from canfb.device.od.dictionary import Dictionary
from canfb.device.pdo import pdo
from canfb.device.pdo.rpdo import Rpdo
from canfb.device.pdo.tpdo import Tpdo
from canfb.device.routing import Handler, RemoteHandler
from canfb.device.sdo.server import TIMEOUT_S
from canfb.device.services import Links, Services, nobody_listens
from canfb.device.silence import Silence
from canfb.device.storage.storage import Storage, Store

LAST_COMMUNICATION_INDEX = 0x1FFF
_BUS = "bus"


class Node(Hooks):
    """A CiA 301 slave without I/O.

    Frames and times go in, frames and the next deadline come out: `start`, `receive` and `tick`
    return what is to be sent, in order, and `deadline` says when `tick` is due next. `now` is
    seconds (monotonic) and must not go back. The node is given its object dictionary and takes its
    communication parameters from it; write those by SDO, or before `start`.

    It reports to the program by `Hooks`. No frame from the bus raises by itself.

    With the node-ID 255 the device has none yet: it stays in INITIALISING and answers LSS only, until
    a master has given it one. A node-ID from LSS is in force from the next reset on; one that was
    stored takes precedence over that of the program.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        node_id: int,
        *,
        autostart: bool = False,
        sdo_timeout_s: float = TIMEOUT_S,
        store: Store | None = None,
        bit_rates_kbit_s: Collection[int] = (),
    ) -> None:
        """Make the node `node_id` (1..127, 255); ValueError for another, or for an impossible EDS.

        With `autostart` it goes on to OPERATIONAL after each boot-up without a master: bit 2 of
        1F80h is then 0 by default. `sdo_timeout_s` is how long an SDO client may be silent within a
        transfer, more than 0 s. `store` keeps what 1010h and LSS save; None: nothing is saved.
        `bit_rates_kbit_s` are those that LSS may choose; they are changed by `on_bit_rate`.
        """
        if not is_node_id(node_id):
            raise ValueError(f"node-ID {node_id} is out of range; use 1 to 127, or 255 for none yet")
        if not 0 < sdo_timeout_s < NEVER:
            raise ValueError(f"sdo_timeout_s is {sdo_timeout_s}; give a time in seconds, more than 0")
        super().__init__()
        self.dictionary = dictionary
        self.node_id = node_id
        self.counters = Counters()
        self._on_rpdo: Callable[[int, float], None] | None = None
        self.storage = Storage(dictionary, store, lambda: self.node_id, self._report_parameters)

        self._operational = False
        self._outbox: list[Frame] = []
        self.moment = Moment()
        """The times of the running call."""
        self._agenda = Agenda()
        self._routes: dict[int, Handler] = {}
        self._remote_routes: dict[int, RemoteHandler] = {}
        self.inhibited: dict[int | None, Callable[[float], None]] = {}
        """By CAN-ID: what `sent` calls; the same mapping for the life of the node."""
        self._sync_rpdos: list[Rpdo] = []
        self._sync_tpdos: list[Tpdo] = []
        self._startup = Startup(dictionary.find(0x1F80), autostart=autostart)
        self._sdo_timeout_s = sdo_timeout_s
        self._silence = Silence(self._silence_ended)
        self.lss = LssSlave(
            dictionary,
            self.storage,
            self.counters,
            self._outbox.append,
            active_node_id=lambda: self.node_id,
            bit_rates_kbit_s=bit_rates_kbit_s,
            activate=self._bit_rate_wanted,
            configured=self._lss_left,
        )
        self._make_services()

    def _make_services(self) -> None:
        """All services that know the node-ID: recreated when it changes."""
        links = Links(
            emit=self._outbox.append,
            state_changed=self._state_changed,
            reset=self._reset,
            lost=self.communication_error,
            time_heard=self._time_heard,
            synchronise=self._synchronise,
            rpdo_too_short=self._rpdo_too_short,
            duplicate=self._duplicate,
            heartbeat_changed=self._heartbeat_changed,
            pdo_changed=self._pdo_changed,
            changed=self._route,
        )
        self._services = Services(
            self.dictionary,
            self.node_id,
            links,
            moment=self.moment,
            counters=self.counters,
            silence=self._silence,
            sdo_timeout_s=self._sdo_timeout_s,
        )
        self._nmt = self._services.nmt
        self._emergency = self._services.emergency
        self._tpdos = self._services.tpdos
        self._agenda.fill(self._services.timed())

    @property
    def state(self) -> NmtState:
        """The NMT state."""
        return self._nmt.state

    @property
    def own_can_ids(self) -> frozenset[int]:
        """The CAN-IDs that only this node may send now; empty while it has no node-ID.

        A recorded log holds the frames of the node itself there: leave them out of a replay.
        """
        return frozenset() if self.node_id == UNCONFIGURED else self._services.own_can_ids()

    @property
    def now(self) -> float:
        """The time of the running call, or of the last one, seconds."""
        return self.moment.now

    @property
    def autostart(self) -> bool:
        """Whether the next boot-up leads to OPERATIONAL without a master (1F80h)."""
        return self._startup.autostart

    @property
    def on_rpdo(self) -> Callable[[int, float], None] | None:
        """The hook for RPDOs; the RPDOs call it themselves, which takes less time."""
        return self._on_rpdo

    @on_rpdo.setter
    def on_rpdo(self, hook: Callable[[int, float], None] | None) -> None:
        self._on_rpdo = hook
        for rpdo in self._services.rpdos:
            rpdo.delivered = nobody_listens if hook is None else hook

    def start(self, now: float) -> list[Frame]:
        """Power on: the boot-up message, then PRE-OPERATIONAL.

        Values stay as they are, but for those that the store keeps.
        """
        self.moment.now = now
        self.storage.power_on()
        self.lss.power_on()
        self._change_node_id(now)
        self._power_up(now)
        return self._sent()

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Take a frame from the bus, whatever it holds; gives what is to be sent."""
        moment = self.moment
        moment.now = now
        can_id, data, rtr, timestamp = frame
        if timestamp is None:
            moment.received, moment.proved = now, False
        elif moment.stamp <= timestamp <= now:  # as usual: later than the last
            moment.received = moment.stamp = timestamp
            moment.proved = True
        else:
            moment.stamped(timestamp)
        if rtr:
            self._receive_remote(can_id, now)
        elif len(data) > LONGEST_DATA:
            self.counters.malformed_frames += 1
        else:
            handler = self._routes.get(can_id)
            if handler is not None:
                handler(data, now)
            elif 0 <= can_id <= HIGHEST_ID:
                self.counters.unknown_cob_ids += 1
            else:
                self.counters.malformed_frames += 1
        outbox = self._outbox
        if not outbox:
            return []
        sent = [] if self._silence.active else outbox[:]
        outbox.clear()
        return sent

    def tick(self, now: float) -> list[Frame]:
        """Do what is due at `now`; gives what is to be sent."""
        moment = self.moment
        moment.now = moment.received = now
        moment.proved = True  # a SYNC of its own goes out now
        self._agenda.tick(now)
        return self._sent()

    def deadline(self) -> float | None:
        """When `tick` is due next, seconds; None when nothing is waiting."""
        if self._outbox:
            return self.moment.now
        agenda = self._agenda
        due = agenda.due() if agenda.moved else agenda.earliest
        return None if due == NEVER else due

    def sent(self, can_id: int, now: float) -> None:
        """A frame that was given out with this CAN-ID went onto the bus at `now`, seconds.

        Inhibit times count from there; a host that never says so counts them from the call that gave
        the frame.
        """
        follow = self.inhibited.get(can_id)
        if follow is not None:
            follow(now)

    def trigger_tpdo(self, number: int, now: float) -> None:
        """An event for TPDO `number`. Outside of OPERATIONAL, or while it is not valid: nothing.

        Types FEh and FFh are sent, at once or after the inhibit time; type 0 at the next SYNC.
        ValueError when the device has no such TPDO.
        """
        self.moment.now = now
        self.tpdo_trigger(number)(now)

    def tpdo_trigger(self, number: int) -> Callable[[float], None]:
        """What `trigger_tpdo` calls for this TPDO, with the time of the running call.

        It holds until the node-ID changes. ValueError when the device has no such TPDO.
        """
        tpdo = self._tpdos.get(number)
        if tpdo is None:
            raise ValueError(f"there is no TPDO {number}; the EDS has {sorted(self._tpdos)}")
        return tpdo.trigger

    def emergency(
        self,
        code: int,
        register_bits: int,
        manufacturer: bytes = b"",
        now: float | None = None,
    ) -> None:
        """Report an error (CiA 301, 7.2.7): EMCY, 1001h and 1003h. Nothing while it is active.

        `register_bits` are the bits of 1001h (0..255), the generic bit is added; `manufacturer` is
        up to 5 bytes. `now` is the time of the running call when it is not given. ValueError for
        values beyond these ranges.
        """
        check_error(code, register_bits, manufacturer)
        self._emergency.report(code, register_bits, manufacturer, self._time(now))

    def clear_emergency(self, code: int, now: float | None = None) -> None:
        """End an error: EMCY 0000h with what is left of 1001h. Nothing when it is not active."""
        self._emergency.clear(code, self._time(now))

    def communication_error(self, now: float) -> None:
        """The device had a communication error, such as bus-off: the NMT state that 1029h:01 names.

        A lost heartbeat and a silent guarding master come here by themselves. EMCY is another matter.
        """
        self.moment.now = now
        self._nmt.enter(self._services.error_behaviour.reaction(self._nmt.state), now)

    def bus_off(self, now: float) -> list[Frame]:
        """The bus is gone: the CAN controller is bus-off, or its interface is down. See 1029h:01."""
        self.communication_error(now)
        return self._sent()

    def bus_back(self, now: float) -> list[Frame]:
        """The bus is back: EMCY 8140h, and 0000h, for the error is over. The NMT state stays.

        Nothing without a node-ID.
        """
        self.moment.now = now
        if self._nmt.state is not NmtState.INITIALISING:
            code = EmergencyCode.BUS_OFF_RECOVERED
            self._emergency.report(code, ErrorRegister.COMMUNICATION, b"", now, _BUS)
            self._emergency.clear(code, now, _BUS)
        return self._sent()

    def _time(self, now: float | None) -> float:
        if now is not None:
            self.moment.now = now
        return self.moment.now

    def _sent(self) -> list[Frame]:
        sent = [] if self._silence.active else self._outbox[:]
        self._outbox.clear()
        return sent

    def _receive_remote(self, can_id: int, now: float) -> None:
        handler = self._remote_routes.get(can_id)
        if handler is None:
            self.counters.remote_frames += 1
        else:
            handler(now)

    def _power_up(self, now: float) -> None:
        """With a node-ID: to the boot-up. Without one there is LSS only (CiA 305)."""
        self._nmt.enter(NmtState.INITIALISING, now)
        if self.node_id == UNCONFIGURED:
            self._wait_for_node_id()
            return
        self.storage.restore()
        self._begin(False, now)

    def _wait_for_node_id(self) -> None:
        self._services.forget()
        self.lss.reset()
        self._route()

    def _change_node_id(self, now: float) -> None:
        """Take over the node-ID of LSS."""
        old, new = self.node_id, self.lss.pending_node_id
        if new == old:
            return
        self._nmt.enter(NmtState.INITIALISING, now)
        self.node_id = new
        self.dictionary.change_node_id(old, new)
        self._make_services()
        self.on_rpdo = self._on_rpdo

    def _lss_left(self, now: float) -> None:
        """The LSS master has left the configuration state: a first node-ID is in force at once."""
        if self.node_id == UNCONFIGURED != self.lss.pending_node_id:
            self._change_node_id(now)
            self._power_up(now)

    def _bit_rate_wanted(self, kbit_s: int, delay_s: float) -> None:
        now = self.moment.now
        if delay_s:
            self._silence.begin(now + 2 * delay_s)
            self._services.silenced(now)
            self._route()
        if self.on_bit_rate is not None:
            self.on_bit_rate(kbit_s, delay_s, now)

    def _silence_ended(self, now: float) -> None:
        self._services.heard_again(now)
        self._route()

    def _reset(self, communication_only: bool, now: float) -> None:
        """NMT reset node or reset communication."""
        last = LAST_COMMUNICATION_INDEX if communication_only else 0xFFFF
        self.dictionary.reset(0x1000, last)
        self._change_node_id(now)
        if self.node_id == UNCONFIGURED:
            self._wait_for_node_id()
            return
        self.storage.restore(communication_only=communication_only)
        self._begin(communication_only, now)

    def _begin(self, communication_only: bool, now: float) -> None:
        """INITIALISING, from the values in the dictionary, up to the state after the boot-up."""
        self._nmt.enter(NmtState.INITIALISING, now)
        self._services.configure(now)
        self.lss.reset()
        if self.on_reset is not None:
            self.on_reset(communication_only, now)
        if self.storage.faults:
            self._report_parameters()
        self._services.producer.boot_up(now)
        self._nmt.enter(NmtState.PRE_OPERATIONAL, now)
        if self._startup.autostart:
            self._nmt.enter(NmtState.OPERATIONAL, now)

    def _state_changed(self, old: NmtState, new: NmtState, now: float) -> None:
        self._operational = new is NmtState.OPERATIONAL
        self._services.enter(old, new, now)
        self._pdo_changed()
        if self.on_state is not None:
            self.on_state(old, new, now)

    def _report_parameters(self) -> None:
        if self.on_parameter_faults is not None:
            self.on_parameter_faults(dict(self.storage.faults), self.moment.now)

    def _heartbeat_changed(self) -> None:
        """1017h was written: a heartbeat takes the place of guarding."""
        if self._services.producer.is_active:
            self._services.guarding.configure(self.moment.now)
        self._route()

    def _pdo_changed(self) -> None:
        self._route()
        if self.on_configured is not None:
            self.on_configured()

    def _route(self) -> None:
        """Who listens to which CAN-ID, in this NMT state and with these COB-IDs."""
        self._sync_rpdos = [rpdo for rpdo in self._services.rpdos if rpdo.is_synchronous]
        self._sync_tpdos = [tpdo for tpdo in self._tpdos.values() if tpdo.is_synchronous]
        routes = self._services.routes()
        routes.add(REQUEST_ID, self.lss.handle)
        self._routes, self._remote_routes = routes.data, routes.remote
        self.inhibited.clear()
        self.inhibited.update(self._services.inhibited())

    def rpdo_with(self, *objects: tuple[int, int]) -> int | None:
        """Number of the first valid RPDO whose mapping holds all these objects (index, sub-index)."""
        return pdo.rpdo_with(self.dictionary, objects)

    def synchronous_rpdo(self, number: int) -> Rpdo | None:
        """RPDO `number` if it is taken over at the SYNC after it came (types 0 to F0h), else None."""
        return next((rpdo for rpdo in self._sync_rpdos if rpdo.number == number), None)

    def _synchronise(self, counter: int | None, now: float) -> None:
        if not self._operational or (self.accepts_sync is not None and not self.accepts_sync(counter, now)):
            return
        for rpdo in self._sync_rpdos:
            rpdo.synchronise(now)
        if self.on_sync is not None:
            self.on_sync(counter, now)
        for tpdo in self._sync_tpdos:
            tpdo.synchronise(counter, now)
        if self.on_synchronised is not None:
            self.on_synchronised()
