"""From power-on to OPERATIONAL (CiA 301, 7.3.2): all services of a node, and their effects on each other.

A reset sets the dictionary to its defaults, then to the stored values; each service then reads its
parameters again (`configure`). Services affect each other only through :class:`LifeCycle`. They are made for
one node-ID, and made again for another.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from functools import partial

from canfb.cia301.cob import ERROR_CONTROL, NMT
from canfb.cia301.codes import COMMANDED, EmergencyCode, ErrorRegister, NmtCommand, NmtState
from canfb.device.core import NEVER, Application, CanIds, Core, Reactions, Timed
from canfb.device.emergency import Emergency
from canfb.device.lss import REQUEST_ID, UNCONFIGURED, LssSlave
from canfb.device.nmt_slave import (
    COMMUNICATING,
    HeartbeatConsumer,
    HeartbeatProducer,
    NodeGuarding,
    error_behaviour,
    startup,
)
from canfb.device.od.dictionary import Dictionary
from canfb.device.sdo.server import SdoServer, channel_indices
from canfb.device.storage.storage import Storage, Store
from canfb.device.sync import Pdos, Sync, TimeStamp


class Silence(Timed):
    """Whether the device is silent, and until when; `boot_up_pending`: a boot-up waits for its end."""

    def __init__(self, life: LifeCycle) -> None:
        self.active = False
        self.boot_up_pending = False
        self._life = life

    def begin(self, until: float) -> None:
        self.deadline = max(until, self.deadline) if self.active else until
        self.active = True

    def tick(self, now: float) -> None:
        self.deadline = NEVER
        self.active = False
        self._life.silence_ended(now)
        self.boot_up_pending = False


_DUPLICATE = "duplicate node-ID"


class Services:
    """All services of one node-ID."""

    def __init__(self, core: Core, silence: Silence) -> None:
        self._core = core
        self._silence = silence
        self.emergency = core.emergency = Emergency(core)  # first: the others report to it
        self.reaction = error_behaviour(core.dictionary)
        self.producer = HeartbeatProducer(core)
        self.guarding = NodeGuarding(core, self.producer)
        self.consumer = HeartbeatConsumer(core)
        self.time_stamp = TimeStamp(core)
        self.sdo_servers = [SdoServer(core, index) for index in channel_indices(core.dictionary)]
        self.pdos = Pdos(core)
        self.sync = Sync(core, self.pdos)

    def timed(self) -> list[Timed]:
        return [
            self._silence,
            self.sync,
            *self.pdos.rpdos.values(),
            *self.pdos.tpdos.values(),
            self.producer,
            self.guarding,
            *self.consumer.monitors,
            self.emergency,
            *self.sdo_servers,
        ]

    def configure(self, now: float) -> None:
        self.emergency.reset()
        self.guarding.configure(now)
        self.consumer.configure(now)
        self.sync.configure()
        for server in self.sdo_servers:
            server.configure()

    def enter(self, old: NmtState, new: NmtState, now: float) -> None:
        """Enable and disable services for the NMT state `new` (CiA 301, 7.3.2.2.5)."""
        operational = new is NmtState.OPERATIONAL
        if old is NmtState.INITIALISING:
            self._silence.boot_up_pending = self._silence.active
        if operational or old is NmtState.OPERATIONAL:
            self.pdos.enable(operational, now)
        if new not in COMMUNICATING:
            self.drop_transfers()
        self.sync.enable(new in COMMUNICATING, now)
        self.allow_emergency(now)

    def drop_transfers(self) -> None:
        for server in self.sdo_servers:
            server.drop()

    def allow_emergency(self, now: float) -> None:
        self.emergency.enable(self._core.state in COMMUNICATING and not self._silence.active, now)

    def route(self) -> None:
        state, routes = self._core.state, self._core.routes
        self.pdos.choose()
        routes.clear()
        routes.sent[self.emergency.can_id] = self.emergency.sent
        if state is NmtState.INITIALISING:
            return
        routes.remote[self.guarding.can_id] = self.guarding.request
        for can_id, handler in self.consumer.routes().items():
            routes.add(can_id, handler)
        if state in COMMUNICATING:
            routes.add(self.sync.can_id, self.sync.drop if self.sync.generates else self.sync.handle)
            routes.add(self.time_stamp.can_id, self.time_stamp.handle)
            for server in [] if self._silence.active else self.sdo_servers:  # silent: no request is executed
                routes.add(server.request_id, server.handle)
        if state is NmtState.OPERATIONAL:
            self.pdos.add_routes(routes)
        for can_id in self.own_can_ids():
            routes.add(can_id, partial(self._duplicate, can_id))

    def _duplicate(self, can_id: int, data: bytes, now: float) -> None:
        """A frame with a CAN-ID that this node alone may send (CiA 301, 7.3.5).

        The first one after a reset gives EMCY 8150h, with the CAN-ID in bytes 3 and 4. The NMT state stays.
        """
        self._core.counters.duplicate_frames += 1
        code, detail = EmergencyCode.CAN_ID_COLLISION, can_id.to_bytes(2, "little")
        if self.emergency.report(code, ErrorRegister.COMMUNICATION, detail, now, _DUPLICATE):
            self._core.application.duplicate_received(can_id, now)

    def own_can_ids(self) -> frozenset[int]:
        """The CAN-IDs that only this node may send, in any NMT state.

        A CAN-ID that it also receives is left out, as its frames do not prove a second node; but 700h +
        node-ID (boot-up, heartbeat) always belongs to them.
        """
        sent = {
            *(server.response_id for server in self.sdo_servers),
            self.emergency.can_id,
            *(tpdo.parameters.configured_can_id for tpdo in self.pdos.tpdos.values()),
        }
        return _without_none(sent - self._received_in_any_state() | {ERROR_CONTROL + self._core.node_id})

    def can_ids(self) -> CanIds:
        asked = {tpdo.parameters.configured_can_id for tpdo in self.pdos.tpdos.values()}
        return CanIds(
            _without_none(self._received_in_any_state() | {REQUEST_ID}) | self.own_can_ids(),
            _without_none(asked | {self.guarding.can_id}),
        )

    def _received_in_any_state(self) -> set[int | None]:
        return {
            NMT,
            self.sync.can_id,
            self.time_stamp.can_id,
            *self.consumer.routes(),
            *(server.request_id for server in self.sdo_servers),
            *(rpdo.parameters.configured_can_id for rpdo in self.pdos.rpdos.values()),
        }


def _without_none(can_ids: Iterable[int | None]) -> frozenset[int]:
    return frozenset(can_id for can_id in can_ids if can_id is not None)


LAST_COMMUNICATION_INDEX = 0x1FFF


class LifeCycle(Reactions):
    """Makes core and services, and reacts to what they notice."""

    def __init__(
        self,
        dictionary: Dictionary,
        node_id: int,
        application: Application,
        *,
        autostart: bool,
        sdo_timeout_s: float,
        store: Store | None,
        bit_rates_kbit_s: Collection[int],
    ) -> None:
        self.core = core = Core(dictionary, node_id, application, self, sdo_timeout_s=sdo_timeout_s)
        self.storage = Storage(core, store)
        self._goes_on = startup(dictionary, autostart=autostart)
        self.silence = Silence(self)
        self.lss = LssSlave(core, self.storage, bit_rates_kbit_s)
        self._make_services()

    def _make_services(self) -> None:
        self.services = Services(self.core, self.silence)
        self.core.agenda.fill([self.storage, *self.services.timed()])

    def power_on(self, now: float) -> None:
        self.node_id_at_power_on()
        self._boot(False, now)

    def node_id_at_power_on(self) -> int:
        """Read the store; return the node-ID with which the node boots."""
        self.storage.power_on()
        self.lss.power_on()
        return self.lss.pending_node_id

    def _boot(self, communication_only: bool, now: float) -> None:
        """Adopt the pending node-ID, restore, and leave INITIALISING, unless there is no node-ID yet."""
        old, new = self.core.node_id, self.lss.pending_node_id
        if new != old:
            self.enter(NmtState.INITIALISING, now)
            self.core.node_id = new
            self.core.dictionary.change_node_id(old, new)
            self._make_services()
        self.lss.reset()
        if self.core.node_id == UNCONFIGURED:
            self.routes_changed()
            return
        self.storage.restore(communication_only=communication_only)
        self.enter(NmtState.INITIALISING, now)
        self.services.configure(now)
        self.core.application.reset_done(communication_only, now)
        if self.storage.faults:
            self.storage.report_faults()
        self.services.producer.boot_up(now)
        self.enter(NmtState.PRE_OPERATIONAL, now)
        if self._goes_on():
            self.enter(NmtState.OPERATIONAL, now)

    def command(self, data: bytes, now: float) -> None:
        """Obey the NMT master."""
        if len(data) != 2:
            self.core.counters.malformed_frames += 1
            return
        command, node_id = data
        if node_id not in (0, self.core.node_id):
            return
        state = COMMANDED.get(command)
        if state is None:
            self.core.counters.malformed_frames += 1
        elif state is NmtState.INITIALISING:
            self.reset(command == NmtCommand.RESET_COMMUNICATION, now)
        else:
            self.enter(state, now)

    def enter(self, state: NmtState, now: float, why: str = "") -> None:
        old = self.core.state
        if state is not old:
            self.core.state = state
            self.services.enter(old, state, now)
            self.pdo_changed()
            self.core.application.state_changed(old, state, now, why)

    def reset(self, communication_only: bool, now: float) -> None:
        last = LAST_COMMUNICATION_INDEX if communication_only else 0xFFFF
        self.core.dictionary.reset(last)
        self._boot(communication_only, now)

    # Reactions

    def communication_error(self, why: str, now: float) -> None:
        """Enter the NMT state of 1029h:01; ``why`` in words."""
        self.core.application.communication_failed(now)
        self.enter(self.services.reaction(self.core.state), now, why)

    def heartbeat_changed(self) -> None:
        if self.services.producer.period_s:
            self.services.guarding.configure(self.core.call.now)
        self.routes_changed()

    def pdo_changed(self) -> None:
        self.routes_changed()
        self.core.application.configuration_changed()

    def routes_changed(self) -> None:
        self.services.route()
        self.core.routes.add(REQUEST_ID, self.lss.handle)
        if self.core.state is not NmtState.INITIALISING:
            self.core.routes.add(NMT, self.command)

    def bit_rate_activated(self, kbit_s: int, delay_s: float) -> None:
        """Begin the silence: end SDO transfers, hold EMCY, have the program change the bit rate."""
        now = self.core.call.now
        if delay_s:
            self.silence.begin(now + 2 * delay_s)
            self.services.drop_transfers()
            self.services.allow_emergency(now)
            self.routes_changed()
        self.core.application.bit_rate_activated(kbit_s, delay_s, now)

    def silence_ended(self, now: float) -> None:
        """Send the boot-up that waited, then EMCY."""
        if self.silence.boot_up_pending:
            self.services.producer.boot_up(now)
        self.services.allow_emergency(now)
        self.routes_changed()

    def lss_left(self, now: float) -> None:
        """A first node-ID takes effect at once."""
        if self.core.node_id == UNCONFIGURED != self.lss.pending_node_id:
            self._boot(False, now)
