"""All PDOs of a node, and what a SYNC does to them."""

from __future__ import annotations

from canfb.device.core import Core
from canfb.device.pdo.mapping import Direction
from canfb.device.pdo.pdo import numbers
from canfb.device.pdo.rpdo import Rpdo
from canfb.device.pdo.tpdo import Tpdo
from canfb.device.routing import Routes


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
