"""A master on an embedded bus, in simulated time, with the SDO client of the tools."""

from __future__ import annotations

import queue
from typing import Any

from canfb.bus.sdo_channel import SharedClient
from canfb.cia301.frame import Frame
from canfb.demo.story import EmbeddedNetwork
from canfb.simulation.embedded_bus import EmbeddedBus

STEP_S = 0.001


class EmbeddedClient(SharedClient):
    def __init__(self, master: EmbeddedMaster, node_id: int, answer_s: float) -> None:
        super().__init__(master.network, node_id, answer_s)
        self._master = master

    def frame(self, within_s: float) -> bytes:
        while self.responses.empty():
            if within_s <= 0.0:
                raise queue.Empty
            self._master.wait(STEP_S)
            within_s -= STEP_S
        data: bytes = self.responses.get()
        return data

    def now(self) -> float:
        return self._master.now()


class EmbeddedMaster:
    """A :class:`canfb.master.access.Master`; an SDO server has ``answer_s`` seconds to respond."""

    def __init__(self, bus: EmbeddedBus, answer_s: float) -> None:
        self.bus = bus
        self.network = EmbeddedNetwork(bus)
        self.network.subscribers = {}
        self.subscribe: Any = self.network.subscribe
        self.unsubscribe: Any = self.network.unsubscribe
        self.clients: dict[int, EmbeddedClient] = {}
        self._answer_s = answer_s

    def sdo(self, node_id: int) -> EmbeddedClient:
        if node_id not in self.clients:
            self.clients[node_id] = EmbeddedClient(self, node_id, self._answer_s)
        return self.clients[node_id]

    def send(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self.bus.send(Frame(can_id, data, remote))

    def now(self) -> float:
        return self.bus.now

    def wait(self, duration_s: float) -> None:
        self.bus.run_until(self.bus.now + duration_s)
