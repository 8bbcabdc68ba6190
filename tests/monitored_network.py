"""A module, its encoder interface and the SYNC on an embedded bus, watched by the model of the monitor."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import can

import canfb
from canfb import Config, Frame, Sample
from canfb.interface.encoder_interface import EncoderInterface
from canfb.monitoring.bus_model import BusModel
from canfb.monitoring.layout import known_layouts
from canfb.monitoring.snapshot import ModuleSnapshot
from canfb.simulation.embedded_bus import EmbeddedBus, SyncProducer
from canfb.simulation.encoder import Motion, MotionSource, Ramp, ShaftEncoder, demo_encoder
from canfb.simulation.scenario import SimulationConfig
from fake_bus import message

BIT_RATE = 1_000_000
NODE, INTERFACE = 0x20, 0x10
RPM = 63.7
PERIOD_S = 1e-3


class Spoiled(MotionSource):
    """A motion that loses samples while ``lost`` is set."""

    lost = False

    def sample_at(self, now: float) -> Sample | None:  # type: ignore[override]
        sample = super().sample_at(now)
        return None if self.lost else sample


class MonitoredNetwork:
    """Frames of real devices in simulated time; ``frames`` has all of them, with their times."""

    def __init__(
        self,
        nodes: Sequence[int] = (NODE,),
        *,
        known: Sequence[int] = (NODE,),
        jitter_us: float = 0.0,
        only_known: bool = False,
        **fields: Any,
    ) -> None:
        self.bus = EmbeddedBus(BIT_RATE)
        configs = [canfb.ModuleConfig(node_id=node, autostart=True, **fields) for node in nodes]
        self.modules = [canfb.FeedbackModule(config) for config in configs]
        shaft = ShaftEncoder(demo_encoder(), 2500, 1, 0.0)
        self.source = Spoiled(shaft, Motion((Ramp(0.2, 0.0), Ramp(0.5, RPM)), ()), PERIOD_S)
        self.interface = EncoderInterface(INTERFACE, self.source, autostart=True)
        layouts = known_layouts(Config(modules=configs), known) if known else []
        self.model = BusModel(layouts, BIT_RATE, only_known=only_known)
        self.frames: list[tuple[Frame, float]] = []
        self.bus.observers.append(self._hear)
        for device in (*self.modules, self.interface):
            self.bus.attach(device)
        self.bus.attach(SyncProducer(PERIOD_S, SimulationConfig(sync_jitter_us=jitter_us), 1))

    def _hear(self, frame: Frame, now: float) -> None:
        self.frames.append((frame, now))
        self.model.receive(frame, now)

    def run(self, seconds: float) -> MonitoredNetwork:
        self.bus.run_until(self.bus.now + seconds)
        return self

    def log(self, path: Path) -> Path:
        """All frames so far in a log of python-can."""
        with can.Logger(path) as writer:
            for frame, now in self.frames:
                writer(message(frame.can_id, frame.data, timestamp=1e6 + now))
        return path

    def module(self, node_id: int = NODE) -> ModuleSnapshot:
        found = [one for node, one in self.model.snapshot(self.bus.now).modules if node.node_id == node_id]
        assert len(found) == 1
        return found[0]
