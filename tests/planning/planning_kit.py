"""A plan from a few words, and a network in simulated time that does what the plan says."""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from canfb.cia301.frame import Frame
from canfb.configuration import Config
from canfb.hosting.hosting import saved_configuration
from canfb.interface.encoder_interface import EncoderInterface
from canfb.module.device_configuration import DeviceConfiguration
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.planning.plan import Plan
from canfb.planning.plan_input import PlanOptions, modules_alike, plan_of
from canfb.signal.correction import CorrectionTable
from canfb.signal.sample import Sample
from canfb.signal.starts import MOST_WAITING
from canfb.simulation.embedded_bus import EmbeddedBus
from canfb.simulation.encoder import Encoder
from played import Sender
from servo_kit import IDEAL_TABLE

NODE, INTERFACE = 0x20, 0x10
RATE_HZ = 1000.0
BIT_RATE = 1_000_000
SYNC, ADC_PDO, POSITION_PDO, PRECISE_PDO = 0x80, 0x190, 0x1A0, 0x2A0
Placed = Callable[[float], float]
"""Position in cycles at a time in seconds."""


def planned(modules: Any = 1, adc_bits: Any = 12, **stated: Any) -> Plan:
    """A plan of modules as delivered."""
    return plan_of(*delivered(modules, adc_bits), PlanOptions(**{"rate_hz": RATE_HZ, **stated}))


@functools.cache
def delivered(modules: int, adc_bits: int) -> tuple[Config, list[DeviceConfiguration]]:
    config = modules_alike(modules, adc_bits)
    return config, [saved_configuration(one) for one in config.modules]


@dataclass
class Turning:
    """A machine whose encoder is at ``placed(time)`` cycles; it remembers where it was at each sample."""

    placed: Placed
    encoder: Encoder = field(default_factory=lambda: Encoder(amplitude_counts=1536.0, noise_lsb=0.5))
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(7))
    truth: list[float] = field(default_factory=list)

    def sample_at(self, now: float) -> Sample:
        position = self.placed(now)
        self.truth.append(position)
        sine, cosine = self.encoder.sample(position, self.rng)
        return Sample(int(sine), int(cosine))

    def next(self) -> Sample | None:
        raise AssertionError("a machine is sampled at a time")


@dataclass
class Outcome:
    """What came of it: each sample of the module against the truth, and the frames on the bus."""

    valid: list[bool]
    errors_cycles: list[float]
    residuals: list[float]
    frames: Counter[int]
    timed: bool = False

    @property
    def always_valid(self) -> bool:
        """From the first sample on; with sample times, once they have told whether it stood at the start."""
        return all(self.valid[MOST_WAITING if self.timed else 0 :])

    @property
    def holds(self) -> bool:
        """All valid, and the count is right."""
        return self.always_valid and max(map(abs, self.errors_cycles)) < 0.2


def play(
    placed: Placed,
    seconds: float,
    *,
    rate_hz: float = RATE_HZ,
    bit_rate: int = BIT_RATE,
    off_s: Callable[[int], float] = lambda k: 0.0,
    between: Callable[[int], list[tuple[float, Frame]]] = lambda k: [],
    table: bool = False,
    **fields: Any,
) -> Outcome:
    """A module with its interface on a wire; SYNC k is due at ``k / rate_hz + off_s(k)``.

    ``between(k)`` are further frames around it: seconds from when it is due, and the frame.
    """
    bus, machine = EmbeddedBus(bit_rate), Turning(placed)
    module = FeedbackModule(ModuleConfig(node_id=NODE, autostart=True, **fields))
    config = module.config
    interface = EncoderInterface(
        INTERFACE, machine, autostart=True, times=config.times, samples_per_sync=config.samples_per_sync
    )
    for device in (interface, module):
        bus.attach(device)
    if table:
        store(module, IDEAL_TABLE)
    outcome = Outcome([], [], [], Counter(), config.times)

    def listen(frame: Frame, now: float) -> None:
        outcome.frames[frame.can_id] += 1
        if frame.can_id == POSITION_PDO and module.feedback is not None:
            found, truth = module.feedback, machine.truth[-1]
            outcome.valid.append(found.valid)
            outcome.valid += [one.valid for one in module.chain.between]
            outcome.residuals += [one.residual for one in module.chain.between]
            outcome.errors_cycles.append(found.cycles + found.phase - truth)
            outcome.residuals.append(found.residual)

    bus.observers.append(listen)
    due = [0.05 + k / rate_hz for k in range(int(seconds * rate_hz))]
    frames = [(at + off_s(k), Frame(SYNC, b"")) for k, at in enumerate(due)]
    frames += [(at + later, frame) for k, at in enumerate(due) for later, frame in between(k)]
    bus.attach(Sender(*frames))
    bus.run_until(0.05 + seconds)
    return outcome


def store(module: FeedbackModule, table: CorrectionTable) -> None:
    """Upload and activate, as a master does."""
    module.dictionary.lookup(0x2020, 1).download(table.to_bytes())
    module.dictionary.lookup(0x2020, 3).download(table.crc32.to_bytes(4, "little"))


def up_to_speed(cycles_per_s: float, cycles_per_s2: float, start_s: float = 0.1) -> Placed:
    """Standstill, a ramp of constant acceleration, then that speed."""
    ramp_s = cycles_per_s / cycles_per_s2

    def placed(now: float) -> float:
        since = max(0.0, now - start_s)
        if since < ramp_s:
            return cycles_per_s2 * since * since / 2.0
        return cycles_per_s * (since - ramp_s / 2.0)

    return placed
