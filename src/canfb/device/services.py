"""The services that know the node-ID, and which of them listens to which CAN-ID."""

from __future__ import annotations

from collections.abc import Iterable

from canfb.cia301.cob import ERROR_CONTROL
from canfb.cia301.nmt import NmtState
from canfb.device.agenda import Timed
from canfb.device.core import Core
from canfb.device.duplicate import DuplicateWatch
from canfb.device.emergency import Emergency
from canfb.device.guarding import NodeGuarding
from canfb.device.heartbeat import HeartbeatConsumer, HeartbeatProducer
from canfb.device.nmt_slave import COMMUNICATING, ErrorBehaviour, Nmt
from canfb.device.pdo.pdos import Pdos
from canfb.device.sdo.channel import SdoChannel, channel_indices
from canfb.device.silence import Silence
from canfb.device.sync import Sync
from canfb.device.time_stamp import TimeStamp

NMT_COMMAND = 0x000


class Services:
    """All services of one node-ID; made again when it changes.

    `configure` and `enter` follow the NMT state machine, `route` says who listens.
    """

    def __init__(self, core: Core, silence: Silence) -> None:
        self._core = core
        self._silence = silence
        self._error_control_id = ERROR_CONTROL + core.node_id
        self.emergency = core.emergency = Emergency(core)  # first: the others report to it
        self.nmt = Nmt(core)
        self.error_behaviour = ErrorBehaviour(core.dictionary)
        self.duplicates = DuplicateWatch(core)
        self.producer = HeartbeatProducer(core)
        self.guarding = NodeGuarding(core, self.producer)
        self.consumer = HeartbeatConsumer(core)
        self.time_stamp = TimeStamp(core)
        self.channels = [SdoChannel(core, index) for index in channel_indices(core.dictionary)]
        self.pdos = Pdos(core)
        self.sync = Sync(core, self.pdos)

    def timed(self) -> list[Timed]:
        """Those with a timer, in the order in which they are called."""
        return [
            self._silence,
            self.sync,
            *self.pdos.rpdos.values(),
            *self.pdos.tpdos.values(),
            self.producer,
            self.guarding,
            self.consumer,
            self.emergency,
            *(channel.server for channel in self.channels),
        ]

    def configure(self, now: float) -> None:
        """Restart with the values in the dictionary, after a reset: no error, no timer, no transfer."""
        self.forget()
        self.guarding.configure(now)
        self.consumer.configure(now)
        self.sync.configure()
        for channel in self.channels:
            channel.configure()

    def forget(self) -> None:
        """No heartbeat until the next boot-up, and no error."""
        self.producer.stop()
        self.emergency.reset()
        self.duplicates.reset()

    def enter(self, old: NmtState, new: NmtState, now: float) -> None:
        """What a change of the NMT state allows and forbids (CiA 301, 7.3.2.2.5)."""
        operational = new is NmtState.OPERATIONAL
        if old is NmtState.INITIALISING:
            self._silence.boot_up_owed = self._silence.active
        if operational or old is NmtState.OPERATIONAL:
            self.pdos.enable(operational, now)
        if new not in COMMUNICATING:
            self._drop_transfers()
        self.sync.enable(new in COMMUNICATING, now)
        self._allow_emergency(now)

    def silenced(self, now: float) -> None:
        """The silence has begun: SDO transfers are given up without a word, EMCY waits."""
        self._drop_transfers()
        self._allow_emergency(now)

    def heard_again(self, now: float) -> None:
        """The silence has ended: a boot-up that fell into it goes out, then EMCY."""
        if self._silence.boot_up_owed:
            self.producer.boot_up(now)
        self._allow_emergency(now)

    def _drop_transfers(self) -> None:
        for channel in self.channels:
            channel.server.drop()

    def _allow_emergency(self, now: float) -> None:
        self.emergency.enable(self._core.state in COMMUNICATING and not self._silence.active, now)

    def route(self) -> None:
        """Find out who listens to which CAN-ID, in this NMT state and with these COB-IDs."""
        state, routes = self._core.state, self._core.routes
        self.pdos.choose()
        routes.clear()
        routes.add_sent(self.emergency.can_id, self.emergency.sent)
        if state is NmtState.INITIALISING:
            return
        routes.add(NMT_COMMAND, self.nmt.handle)
        routes.add_remote(self.guarding.can_id, self.guarding.request)
        for can_id, handler in self.consumer.routes().items():
            routes.add(can_id, handler)
        if state in COMMUNICATING:
            routes.add(self.sync.can_id, self.sync.handle)
            routes.add(self.time_stamp.can_id, self.time_stamp.handle)
            for channel in [] if self._silence.active else self.channels:  # no answer: nothing is written
                routes.add(channel.request_id, channel.server.handle)
        if state is NmtState.OPERATIONAL:
            self.pdos.add_routes(routes)
        for can_id in self.own_can_ids():
            routes.add(can_id, self.duplicates.handler(can_id))

    def own_can_ids(self) -> frozenset[int]:
        """The CAN-IDs that only this node may send, in any NMT state.

        One that the node is also configured to listen to is not among them: there are other senders,
        and the configuration wants them. Boot-up and heartbeat are always its own.
        """
        sent = {
            *(channel.response_id for channel in self.channels),
            self.emergency.can_id,
            *(tpdo.configured_can_id for tpdo in self.pdos.tpdos.values()),
        }
        return _without_none(sent - self._heard_in_any_state() | {self._error_control_id})

    def can_ids_in_any_state(self) -> frozenset[int]:
        """The CAN-IDs of data frames that do anything in some NMT state, with the present parameters."""
        return _without_none(self._heard_in_any_state()) | self.own_can_ids()

    def remote_can_ids_in_any_state(self) -> frozenset[int]:
        """Those of remote frames."""
        asked = {tpdo.configured_can_id for tpdo in self.pdos.tpdos.values()}
        return _without_none(asked | {self.guarding.can_id})

    def _heard_in_any_state(self) -> set[int | None]:
        """What is listened to in some NMT state; None for what is not in use."""
        return {
            NMT_COMMAND,
            self.sync.can_id,
            self.time_stamp.can_id,
            *self.consumer.routes(),
            *(channel.request_id for channel in self.channels),
            *(rpdo.configured_can_id for rpdo in self.pdos.rpdos.values()),
        }


def _without_none(can_ids: Iterable[int | None]) -> frozenset[int]:
    return frozenset(can_id for can_id in can_ids if can_id is not None)
