from __future__ import annotations

import struct
from typing import Any

import canopen

from canfb.cia301.frame import Frame
from canfb.demo.demo_network import EmbeddedNetwork
from canfb.device.storage.storage import Store
from canfb.eds_files import eds_path
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.simulation.embedded_bus import EmbeddedBus
from ideal_tracks import counts_at

SYNC = Frame(0x80, b"")


class Bench:
    """A module on an embedded bus with python canopen's master, and an encoder interface played by hand."""

    place: float  # for tests that turn it in steps

    def __init__(self, store: Store | None = None, **fields: Any) -> None:
        self.bus = EmbeddedBus()
        self.heard: list[Frame] = []
        self.network = EmbeddedNetwork(self.bus)
        self.module = FeedbackModule(ModuleConfig(node_id=32, **fields), store)
        self.remote = canopen.RemoteNode(32, str(eds_path("canfb-module")))
        self.network.add_node(self.remote)
        self.sdo = self.remote.sdo
        self.bus.observers.append(lambda frame, now: self.heard.append(frame))
        self.bus.attach(self.module)
        self.interval_s = 1e-3

    def start(self) -> None:
        self.remote.nmt.state = "OPERATIONAL"

    def sync(self) -> list[Frame]:
        """The next SYNC; what the module sends upon it."""
        self.bus.run_until(self.bus.now + self.interval_s)
        return self.sent(SYNC)

    def sent(self, frame: Frame) -> list[Frame]:
        before = len(self.heard)
        self.bus.send(frame)
        return [heard for heard in self.heard[before:] if heard != frame]

    def counts(self, sine: int, cosine: int) -> list[Frame]:
        return self.sent(Frame(0x190, struct.pack("<hh", sine, cosine)))

    def at(self, position_cycles: float, amplitude: float = 1500.0) -> tuple[int, int, int]:
        """One SYNC and one sample at this position: the position PDO's fields."""
        self.sync()
        return self.position(self.counts(*counts_at(position_cycles, amplitude)))

    @staticmethod
    def position(frames: list[Frame]) -> tuple[int, int, int]:
        """6004h, status word, residual of the only position PDO among these frames."""
        (data,) = [frame.data for frame in frames if frame.can_id == 0x1A0]
        return struct.unpack("<IHH", data)

    def emergencies(self) -> list[int]:
        return [struct.unpack_from("<H", frame.data)[0] for frame in self.heard if frame.can_id == 0xA0]
