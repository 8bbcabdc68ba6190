"""From power-on to OPERATIONAL: the NMT state, resets, the node-ID, and what else follows from the bus."""

from __future__ import annotations

from collections.abc import Collection

from canfb.cia301.nmt import NmtState
from canfb.device.application import Application
from canfb.device.core import Core, Reactions
from canfb.device.lss.lss import REQUEST_ID, UNCONFIGURED, LssSlave
from canfb.device.nmt_slave import Startup
from canfb.device.od.dictionary import Dictionary
from canfb.device.routing import CanIds
from canfb.device.services import Services
from canfb.device.silence import Silence
from canfb.device.storage.storage import Storage
from canfb.device.storage.writing import Store

LAST_COMMUNICATION_INDEX = 0x1FFF


class LifeCycle(Reactions):
    """Makes the core and all services of a node, and reacts to what they notice.

    LSS, storage and silence are there from the beginning; `services` are others with each node-ID.
    """

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
        self._application = application
        self._reason = ""  # why the NMT state changes in the running call; "" for a command or a start
        self.storage = Storage(core, store)
        self.startup = Startup(dictionary.find(0x1F80), autostart=autostart)
        self.silence = Silence(core)
        self.lss = LssSlave(core, self.storage, bit_rates_kbit_s)
        self._make_services()

    def _make_services(self) -> None:
        self.services = Services(self.core, self.silence)
        writing = self.storage.writing
        self.core.agenda.fill([*([] if writing is None else [writing]), *self.services.timed()])

    def power_on(self, now: float) -> None:
        """To the boot-up, with what the store keeps; see `Node.start`."""
        self.storage.power_on()
        self.lss.power_on()
        self._change_node_id(now)
        self._power_up(now)

    def can_ids(self) -> CanIds:
        """Which CAN-IDs are listened to, now and in any NMT state."""
        data, remote = frozenset(self.core.routes.data), frozenset(self.core.routes.remote)
        always = frozenset({REQUEST_ID})
        if self.core.node_id == UNCONFIGURED:
            return CanIds(data, remote, data | always, remote)
        services = self.services
        return CanIds(
            data,
            remote,
            services.can_ids_in_any_state() | always,
            services.remote_can_ids_in_any_state(),
        )

    def enter(self, state: NmtState, now: float) -> None:
        """Go to an NMT state; nothing happens when the node is in it."""
        self.services.nmt.enter(state, now)

    def _power_up(self, now: float) -> None:
        """With a node-ID: to the boot-up. Without one there is LSS only (CiA 305)."""
        self.enter(NmtState.INITIALISING, now)
        if self.core.node_id == UNCONFIGURED:
            self._wait_for_node_id()
            return
        self.storage.restore()
        self._begin(False, now)

    def _wait_for_node_id(self) -> None:
        self.services.forget()
        self.lss.reset()
        self.routes_changed()

    def _change_node_id(self, now: float) -> None:
        """Take over the node-ID of LSS."""
        old, new = self.core.node_id, self.lss.pending_node_id
        if new == old:
            return
        self.enter(NmtState.INITIALISING, now)
        self.core.node_id = new
        self.core.dictionary.change_node_id(old, new)
        self._make_services()

    def _begin(self, communication_only: bool, now: float) -> None:
        """INITIALISING, from the values in the dictionary, up to the state after the boot-up."""
        self.enter(NmtState.INITIALISING, now)
        self.services.configure(now)
        self.lss.reset()
        self._application.reset_done(communication_only, now)
        if self.storage.faults:
            self.storage.report_faults()
        self.services.producer.boot_up(now)
        self.enter(NmtState.PRE_OPERATIONAL, now)
        if self.startup.autostart:
            self.enter(NmtState.OPERATIONAL, now)

    # Reactions

    def state_changed(self, old: NmtState, new: NmtState, now: float) -> None:
        """Services begin or end with the NMT state."""
        self.services.enter(old, new, now)
        self.pdo_changed()
        self._application.state_changed(old, new, now, self._reason)

    def reset(self, communication_only: bool, now: float) -> None:
        """To the boot-up again, from the defaults and what is stored."""
        last = LAST_COMMUNICATION_INDEX if communication_only else 0xFFFF
        self.core.dictionary.reset(0x1000, last)
        self._change_node_id(now)
        if self.core.node_id == UNCONFIGURED:
            self._wait_for_node_id()
            return
        self.storage.restore(communication_only=communication_only)
        self._begin(communication_only, now)

    def communication_error(self, why: str, now: float) -> None:
        """The NMT state that 1029h:01 names; `why` is the reason of the change."""
        self._application.communication_failed(now)
        self._reason = why
        self.enter(self.services.error_behaviour.reaction(self.core.state), now)
        self._reason = ""

    def heartbeat_changed(self) -> None:
        """A heartbeat takes the place of guarding."""
        if self.services.producer.is_active:
            self.services.guarding.configure(self.core.moment.now)
        self.routes_changed()

    def pdo_changed(self) -> None:
        """Other CAN-IDs, and perhaps other mappings."""
        self.routes_changed()
        self._application.configuration_changed()

    def routes_changed(self) -> None:
        """All listeners again; LSS listens in every state."""
        self.services.route()
        self.core.routes.add(REQUEST_ID, self.lss.handle)

    def bit_rate_activated(self, kbit_s: int, delay_s: float) -> None:
        """Silence; the program changes the bit rate."""
        now = self.core.moment.now
        if delay_s:
            self.silence.begin(now + 2 * delay_s)
            self.services.silenced(now)
            self.routes_changed()
        self._application.bit_rate_activated(kbit_s, delay_s, now)

    def silence_ended(self, now: float) -> None:
        """The node is back."""
        self.services.heard_again(now)
        self.routes_changed()

    def lss_left(self, now: float) -> None:
        """A first node-ID is in force at once; another one, from the next reset on."""
        if self.core.node_id == UNCONFIGURED != self.lss.pending_node_id:
            self._change_node_id(now)
            self._power_up(now)
