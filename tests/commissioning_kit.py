"""A module, an encoder interface and a SYNC in simulated time, and the master that commissions them."""

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np

from canfb import FeedbackModule, Frame, ModuleConfig
from canfb.device.storage.storage import Store
from canfb.interface.encoder_interface import EncoderInterface, SampleClock
from canfb.master.access import NodeAccess
from canfb.master.all_or_nothing import put_in_force
from canfb.master.samples import TrackSamples
from canfb.signal.correction import NO_CORRECTION, Correction
from canfb.simulation.embedded_bus import REGULAR, EmbeddedBus, SyncProducer, SyncTiming
from canfb.simulation.encoder import Encoder, Harmonic, Motion, MotionSource, Ripple, ShaftEncoder
from ideal_tracks import wavy_table
from played import Changing
from tools.soak import embedded_master

MODULE_ID, INTERFACE_ID = 0x20, 0x10
RATE_HZ = 1000.0
CYCLES = 2500
ANSWER_S = 0.05
TABLE, OTHER = wavy_table(), wavy_table(amplitude=-0.02)


def random_encoder(seed: int) -> Encoder:
    """An encoder of the quality that is bought: drawn anew for each seed."""
    rng = np.random.default_rng(seed)
    return Encoder(
        amplitude_counts=float(rng.uniform(1100, 1700)),
        sine_offset=float(rng.uniform(-0.06, 0.06)),
        cosine_offset=float(rng.uniform(-0.06, 0.06)),
        sine_amplitude=float(rng.uniform(0.93, 1.07)),
        cosine_amplitude=float(rng.uniform(0.93, 1.07)),
        phase_error_rad=float(rng.uniform(-0.08, 0.08)),
        harmonics=(
            Harmonic(2, *rng.uniform(0.0, 0.006, 2).tolist(), *rng.uniform(-3, 3, 2).tolist()),
            Harmonic(3, *rng.uniform(0.0, 0.012, 2).tolist(), *rng.uniform(-3, 3, 2).tolist()),
        ),
        noise_lsb=float(rng.uniform(0.3, 1.0)),
    )


class EmbeddedMaster(embedded_master.EmbeddedMaster):
    """Notes what a tool sends, and says when it waits."""

    def __init__(self, bus: EmbeddedBus) -> None:
        super().__init__(bus, ANSWER_S)
        self.sent: list[Frame] = []
        self.on_wait: Callable[[float], None] = lambda now: None
        bus.observers.append(self._note)

    def _note(self, frame: Frame, now: float) -> None:
        if 0x600 < frame.can_id < 0x680 or frame.can_id in (0x000, 0x080):
            self.sent.append(frame)

    def wait(self, duration_s: float) -> None:
        self.on_wait(self.bus.now)
        super().wait(duration_s)


@dataclass
class Bench:
    """The network, powered on and operational, SYNC running."""

    encoder: Encoder = field(default_factory=lambda: random_encoder(1))
    rpm: float = 600.0
    sync: bool = True
    operational: bool = True
    motion: Motion | None = None
    config: dict[str, Any] = field(default_factory=dict)
    store: Store | None = None
    timing: SyncTiming | None = None  # SYNCs that jitter, samples in true time, and their times in the PDO

    def __post_init__(self) -> None:
        self.bus = EmbeddedBus()
        timed = self.timing is not None
        turning = Motion((), (Ripple(0.02 * self.rpm, 0.31), Ripple(0.01 * self.rpm, 1.7)), self.rpm)
        shaft = ShaftEncoder(self.encoder, CYCLES, seed=7)
        if not timed:  # nobody gets the counts of the coarse track, which take half of the time of a sample
            shaft._coarse = SimpleNamespace(sample=lambda position, rng: (0, 0))  # type: ignore[assignment]
        self.source = Changing(MotionSource(shaft, self.motion or turning, 1.0 / RATE_HZ))
        self.module = FeedbackModule(
            ModuleConfig(
                node_id=MODULE_ID,
                encoder_interface=INTERFACE_ID,
                cycles_per_revolution=CYCLES,
                autostart=self.operational,
                times=timed,
                **self.config,
            ),
            self.store,
        )
        self.interface = EncoderInterface(
            INTERFACE_ID,
            self.source.source if timed else self.source,
            autostart=self.operational,
            times=timed,
            samples_per_sync=self.config.get("samples_per_sync", 1),
            clock=SampleClock(100.0, 0xFFFF0000),
        )
        self.master = EmbeddedMaster(self.bus)
        for device in (self.module, self.interface):
            self.bus.attach(device)
        if self.sync:
            self.bus.attach(SyncProducer(1.0 / RATE_HZ, self.timing or REGULAR))

        self.access = NodeAccess(self.master, MODULE_ID, "module")
        self.interface_access = NodeAccess(self.master, INTERFACE_ID, "encoder interface")

    def value(self, index: int, subindex: int) -> Any:
        return self.module.dictionary.entry(index, subindex).value


def running(seconds: float = 0.5, **fields: Any) -> Bench:
    """The bench after so many seconds."""
    bench = Bench(**fields)
    bench.bus.run_until(seconds)
    return bench


def bench_with(used: Correction = NO_CORRECTION, **fields: Any) -> Bench:
    """A bench without SYNC whose module computes with this correction."""
    bench = Bench(sync=False, **fields)
    if used != NO_CORRECTION:
        put_in_force(bench.access, used)
    return bench


def lose(bench: Bench) -> Bench:
    """It has no samples for a while; its position is lost then."""
    bench.source.change = lambda counts: None
    bench.bus.run_until(bench.bus.now + 0.05)
    bench.source.change = lambda counts: counts
    bench.bus.run_until(bench.bus.now + 0.5)
    assert bench.value(0x2011, 1) & 4
    return bench


def heard(bench: Bench) -> list[Frame]:
    """All frames on its bus from now on."""
    frames: list[Frame] = []
    bench.bus.observers.append(lambda frame, now: frames.append(frame))
    return frames


def recorded(
    encoder: Encoder, n: int, rpm: float = 600.0, start_s: float = 0.0, seed: int = 5
) -> TrackSamples:
    """Samples of a machine that turns at about ``rpm``, without a bus."""
    motion = Motion((), (Ripple(0.02 * rpm, 0.31), Ripple(0.01 * rpm, 1.7)), rpm)
    times = start_s + np.arange(n) / RATE_HZ
    position = np.array([motion.revolutions(float(time)) for time in times]) * CYCLES
    sine, cosine = encoder.sample(position, np.random.default_rng(seed))
    return TrackSamples.of(sine, cosine, RATE_HZ, "a simulated machine")
