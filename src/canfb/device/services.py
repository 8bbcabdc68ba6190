"""The services that know the node-ID, and which of them listens to which CAN-ID."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from canfb.cia301.cob import ERROR_CONTROL
from canfb.cia301.nmt import NmtState
from canfb.device.agenda import Timed
from canfb.device.counters import Counters
from canfb.device.duplicate import DuplicateWatch
from canfb.device.emergency import Emergency
from canfb.device.guarding import NodeGuarding
from canfb.device.heartbeat import HeartbeatConsumer, HeartbeatProducer
from canfb.device.moment import Emit, Moment
from canfb.device.nmt_slave import COMMUNICATING, ErrorBehaviour, Nmt
from canfb.device.od.dictionary import Dictionary
from canfb.device.pdo import pdo
from canfb.device.pdo.mapping import Direction
from canfb.device.pdo.rpdo import Rpdo
from canfb.device.pdo.tpdo import Tpdo
from canfb.device.routing import Routes
from canfb.device.sdo.channel import SdoChannel, channel_indices
from canfb.device.silence import Silence
from canfb.device.sync import Sync
from canfb.device.time_stamp import TimeStamp

NMT_COMMAND = 0x000


@dataclass(frozen=True, slots=True, kw_only=True)
class Links:
    """What the services call in the node."""

    emit: Emit
    state_changed: Callable[[NmtState, NmtState, float], None]
    reset: Callable[[bool, float], None]
    lost: Callable[[float], None]
    """A heartbeat or the guarding master is lost."""
    time_heard: Callable[[int, int, float], None]
    synchronise: Callable[[int | None, float], None]
    rpdo_too_short: Callable[[int, int, int, float], None]
    duplicate: Callable[[int, float], None]
    heartbeat_changed: Callable[[], None]
    pdo_changed: Callable[[], None]
    changed: Callable[[], None]
    """A COB-ID has changed: the routes are others now."""


class Services:
    """All services of one node-ID; recreated when it changes.

    `configure` and `enter` follow the NMT state machine, `routes` says who listens.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        node_id: int,
        links: Links,
        *,
        moment: Moment,
        counters: Counters,
        silence: Silence,
        sdo_timeout_s: float,
    ) -> None:
        self._silence = silence
        emit, changed = links.emit, links.changed
        self._error_control_id = ERROR_CONTROL + node_id
        self.nmt = nmt = Nmt(node_id, counters, links.state_changed, links.reset)
        self.error_behaviour = ErrorBehaviour(dictionary)
        self.emergency = emergency = Emergency(dictionary, node_id, emit, counters, changed)
        self.duplicates = DuplicateWatch(counters, emergency, links.duplicate)
        self.producer = producer = HeartbeatProducer(
            dictionary.find(0x1017), node_id, emit, moment, lambda: nmt.state, links.heartbeat_changed
        )
        self.guarding = NodeGuarding(
            dictionary,
            node_id,
            emit,
            moment,
            emergency,
            state=lambda: nmt.state,
            heartbeat=lambda: producer.is_active,
            lost=links.lost,
        )
        self.time_stamp = TimeStamp(dictionary.find(0x1012), counters, links.time_heard, changed)
        self.consumer = HeartbeatConsumer(dictionary, moment, counters, emergency, links.lost, changed)
        self.sync = Sync(dictionary, emit, moment, counters, emergency, links.synchronise, changed)
        self.channels = [
            SdoChannel(dictionary, index, node_id, emit, counters, changed, timeout_s=sdo_timeout_s)
            for index in channel_indices(dictionary)
        ]
        self.rpdos = [
            Rpdo(
                dictionary,
                number,
                moment=moment,
                counters=counters,
                emergency=emergency,
                window_open=self.sync.window_open,
                delivered=nobody_listens,
                too_short=links.rpdo_too_short,
                changed=links.pdo_changed,
            )
            for number in pdo.numbers(dictionary, Direction.RECEIVE)
        ]
        self.tpdos = {
            number: Tpdo(dictionary, number, emit=emit, moment=moment, changed=links.pdo_changed)
            for number in pdo.numbers(dictionary, Direction.TRANSMIT)
        }

    def timed(self) -> list[Timed]:
        """Those with a timer, in the order in which they are called."""
        return [
            self._silence,
            self.sync,
            *self.rpdos,
            *self.tpdos.values(),
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
            for rpdo in self.rpdos:
                rpdo.enable(operational, now)
            for tpdo in self.tpdos.values():
                tpdo.enable(operational, now)
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
        self.emergency.enable(self.nmt.state in COMMUNICATING and not self._silence.active, now)

    def routes(self) -> Routes:
        """Who listens to which CAN-ID, in this NMT state and with these COB-IDs."""
        routes = Routes()
        state = self.nmt.state
        if state is NmtState.INITIALISING:
            return routes
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
            for rpdo in self.rpdos:
                routes.add(rpdo.can_id, rpdo.handle)
            for tpdo in self.tpdos.values():
                routes.add_remote(tpdo.remote_can_id, tpdo.request)
        for can_id in self.own_can_ids():
            routes.add(can_id, self.duplicates.handler(can_id))
        return routes

    def inhibited(self) -> dict[int | None, Callable[[float], None]]:
        """What to call when a frame has left, by CAN-ID: an inhibit time counts from there."""
        tpdos = {tpdo.configured_can_id: tpdo.sent for tpdo in self.tpdos.values() if tpdo.is_inhibited}
        return {self.emergency.can_id: self.emergency.sent, **tpdos}

    def own_can_ids(self) -> frozenset[int]:
        """The CAN-IDs that only this node may send, in any NMT state.

        One that the node is also configured to listen to is not among them: there are other senders,
        and the configuration wants them. Boot-up and heartbeat are always its own.
        """
        sent = [
            *(channel.response_id for channel in self.channels),
            self.emergency.can_id,
            *(tpdo.configured_can_id for tpdo in self.tpdos.values()),
        ]
        heard = {
            NMT_COMMAND,
            self.sync.can_id,
            self.time_stamp.can_id,
            *self.consumer.routes(),
            *(channel.request_id for channel in self.channels),
            *(rpdo.configured_can_id for rpdo in self.rpdos),
        }
        own = {can_id for can_id in sent if can_id is not None and can_id not in heard}
        return frozenset(own | {self._error_control_id})


def nobody_listens(number: int, now: float) -> None:
    """In place of a hook for RPDOs that is not there."""
