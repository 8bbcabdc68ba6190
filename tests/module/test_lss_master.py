"""Modules and the encoder interface under python canopen's LSS master, on an embedded bus."""

from __future__ import annotations

import canopen
import canopen.lss
import pytest

from canfb.demo.story import EmbeddedNetwork
from canfb.device.storage.storage import MemoryStore
from canfb.eds_files import eds_path
from canfb.interface.encoder_interface import EncoderInterface
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.signal.sample import Sample
from canfb.simulation.embedded_bus import EmbeddedBus

MODULE = (0, 1, 1)  # vendor-ID, product code, revision number
INTERFACE = (0, 2, 1)
NONE = 255


class Still:
    def next(self) -> Sample:
        return Sample(0, 1500)


class Bus:
    """A bus with an LSS master that need not wait: an answer is there at once or never."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(canopen.lss.time, "sleep", lambda seconds: None)
        self.bus = EmbeddedBus()
        self.network = EmbeddedNetwork(self.bus)
        self.lss = self.network.lss
        self.lss.RESPONSE_TIMEOUT = 0
        self.heard: list[int] = []
        self.bus.observers.append(lambda frame, now: self.heard.append(frame.can_id))

    def module(self, node_id: int, serial_number: int, store: MemoryStore | None = None) -> FeedbackModule:
        config = ModuleConfig(node_id=node_id, serial_number=serial_number)
        module = FeedbackModule(config, store, bit_rates_kbit_s=[1000, 500])
        self.bus.attach(module)
        return module

    def master(self, node_id: int, eds: str = "canfb-module") -> canopen.RemoteNode:
        return self.network.add_node(canopen.RemoteNode(node_id, str(eds_path(eds))))

    def wait(self) -> None:
        self.lss.send_switch_state_global(self.lss.WAITING_STATE)


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> Bus:
    return Bus(monkeypatch)


def test_devices_without_a_node_id_get_one_after_the_other(bus: Bus) -> None:
    """Lowest identity first, until nobody answers."""
    for serial_number in (300, 5, 77):
        bus.module(NONE, serial_number)
    bus.bus.attach(EncoderInterface(NONE, Still(), serial_number=5))
    assert bus.heard == []
    found = []
    for node_id in range(10, 20):
        there, identity = bus.lss.fast_scan()
        if not there:
            break
        found.append(tuple(identity))
        bus.lss.configure_node_id(node_id)
        bus.wait()
        assert bus.heard[-1] == 0x700 + node_id
    assert found == [(*MODULE, 5), (*MODULE, 77), (*MODULE, 300), (*INTERFACE, 5)]
    sdos = [bus.master(node_id).sdo for node_id in (10, 11, 12)]
    assert [sdo[0x1018][4].raw for sdo in sdos] == [5, 77, 300]
    assert bus.master(13, "encoder-interface").sdo[0x1800][1].raw == 0x4000018D
    bus.network.nmt.state = "OPERATIONAL"
    bus.bus.run_until(1.0)
