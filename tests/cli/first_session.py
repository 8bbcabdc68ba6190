"""The first session of the README in simulated time: module, encoder interface, SYNC, and what they did."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from canfb.cia301.frame import Frame
from canfb.cli.config_file import EXAMPLE
from canfb.cli.main import build_parser
from canfb.cli.simulate import chosen
from canfb.configuration import Config, parse_config
from canfb.interface.encoder_interface import EncoderInterface
from canfb.module.feedback_module import FeedbackModule
from canfb.signal.supervision import VALID
from canfb.simulation.embedded_bus import EmbeddedBus
from canfb.simulation.set_up import source_of
from canfb.simulation.sync_producer import SyncProducer

START_ALL = Frame(0x000, b"\x01\x00")
POSITION = 0x1A0


@dataclass
class Session:
    """``canfb run`` and ``canfb simulate --rate`` on one bus, with the options of the latter."""

    rate_hz: float
    options: Sequence[str] = ()
    text: str = EXAMPLE
    statuses: list[int] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)
    """Of each position, cycles, against the truth."""

    def __post_init__(self) -> None:
        self.config: Config = parse_config(self.text)
        arguments = ["simulate", "feedback.yaml", "--rate", str(self.rate_hz), *self.options]
        self.source: Any = source_of(*chosen(build_parser().parse_args(arguments), self.config))
        self.module = FeedbackModule(self.config.modules[0])
        config = self.config.modules[0]
        self.interface = EncoderInterface(config.encoder_interface, self.source, times=config.times)
        self.bus = EmbeddedBus()
        for device in (self.module, self.interface, SyncProducer(1.0 / self.rate_hz)):
            self.bus.attach(device)
        self.bus.observers.append(self._note)

    def _note(self, frame: Frame, now: float) -> None:
        if frame.can_id == POSITION:
            self.statuses.append(int.from_bytes(frame.data[4:6], "little"))
            feedback = self.module.feedback
            assert feedback is not None
            if hasattr(self.source, "position_cycles"):
                self.errors.append(feedback.cycles + feedback.phase - self.source.position_cycles)

    def run(self, duration_s: float) -> None:
        """Start all nodes, and let time pass."""
        self.bus.send(START_ALL)
        self.bus.run_until(self.bus.now + duration_s)

    @property
    def valid(self) -> list[bool]:
        """Of each position PDO."""
        return [bool(status & VALID) for status in self.statuses]
