"""A master on an embedded bus, in simulated time: python canopen's SDO client behind it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import canopen
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoCommunicationError

from canfb.cia301.frame import Frame
from canfb.demo.demo_network import EmbeddedNetwork
from canfb.simulation.embedded_bus import EmbeddedBus

STEP_S = 0.001


class EmbeddedClient(SdoClient):
    """python canopen's SDO client; simulated time passes while it waits."""

    wait: Callable[[float], None]

    def read_response(self) -> bytes:
        left = self.RESPONSE_TIMEOUT
        while self.responses.empty():
            if left <= 0.0:
                raise SdoCommunicationError("No SDO response received")
            self.wait(STEP_S)
            left -= STEP_S
        inherited: Any = super()
        answer: bytes = inherited.read_response()
        return answer


class EmbeddedMaster:
    """:class:`canfb.master.access.Master`; an SDO server has ``answer_s`` seconds for its response."""

    def __init__(self, bus: EmbeddedBus, answer_s: float) -> None:
        self.bus = bus
        self.network = EmbeddedNetwork(bus)
        self.network.subscribers = {}
        self.clients: dict[int, EmbeddedClient] = {}
        self._answer_s = answer_s

    def sdo(self, node_id: int) -> Any:
        if node_id not in self.clients:
            make: Any = EmbeddedClient
            dictionary: Any = canopen.ObjectDictionary
            client: EmbeddedClient = make(0x600 + node_id, 0x580 + node_id, dictionary())
            client.RESPONSE_TIMEOUT = self._answer_s
            client.network = self.network
            client.wait = self.wait
            self.network.subscribe(client.tx_cobid, client.on_response)
            self.clients[node_id] = client
        return self.clients[node_id]

    def subscribe(self, can_id: int, hear: Any) -> None:
        self.network.subscribe(can_id, hear)

    def unsubscribe(self, can_id: int, hear: Any) -> None:
        self.network.unsubscribe(can_id, hear)

    def send(self, can_id: int, data: bytes) -> None:
        self.bus.send(Frame(can_id, data))

    def request(self, can_id: int) -> None:
        self.bus.send(Frame(can_id, b"", True))

    def now(self) -> float:
        return self.bus.now

    def wait(self, duration_s: float) -> None:
        self.bus.run_until(self.bus.now + duration_s)
