"""A module that measures its own reference, and the master that lets it."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from typing import Any

import numpy as np
from module_bench import Bench

from canfb.calibration.result import Reason
from canfb.module.objects.calibrating import CalibrationJob, Outcome
from canfb.objects import MeasurementCommand as Command
from canfb.objects import MeasurementState as State
from canfb.objects import StatusBit
from canfb.signal.phase import FloatArray
from canfb.signal.sample_recording import SampleRecording
from canfb.simulation.encoder import Encoder, Harmonic

ENCODER = Encoder(
    amplitude_counts=1500.0,
    sine_offset=0.03,
    cosine_offset=-0.02,
    sine_amplitude=1.04,
    cosine_amplitude=0.97,
    phase_error_rad=0.06,
    harmonics=(Harmonic(2, 0.008, 0.006, 0.4, 1.1), Harmonic(3, 0.01, 0.012)),
    noise_lsb=0.5,
)
NUMBER = {reason: reason.number for reason in Reason}
SAMPLES = 3000
DEVICE_STATE, INVALID_VALUE = 0x08000022, 0x06090030
Counts = tuple[int, int]


def motion(cycles_per_sample: float, samples: int, rng: np.random.Generator) -> FloatArray:
    """From standstill up to a speed that wanders by 3 %; positions in cycles."""
    time = np.arange(samples)
    ramp = min(samples // 4, 1000)
    speed = cycles_per_sample * (1.0 + 0.03 * np.sin(time / 190.0 + rng.uniform(0.0, 6.0)))
    return np.cumsum(speed * np.minimum(1.0, time / ramp))


def counts_of(encoder: Encoder, position: FloatArray, rng: np.random.Generator) -> list[Counts]:
    sine, cosine = encoder.sample(position, rng)
    return list(zip(sine.tolist(), cosine.tolist(), strict=True))


def computed(encoder: Encoder, seed: int = 1) -> Outcome:
    """What the module's own computation makes of a good recording of this encoder."""
    rng = np.random.default_rng(seed)
    recording = SampleRecording()
    for counts in counts_of(encoder, motion(0.31, 2000, rng), rng):
        recording.take(*counts)
    return CalibrationJob(recording.to_bytes(), None, 12)()


@functools.cache
def good_outcome() -> Outcome:
    """One measurement for all tests that need just any."""
    found = computed(ENCODER)
    assert found.reason == "accepted", found.text
    return found


class Measuring(Bench):
    """The bench with object 2030h in the master's words; nothing is computed unless a test says so."""

    def __init__(self, samples: int = SAMPLES, **fields: Any) -> None:
        super().__init__(**fields)
        self.bus.computes = False
        self.sdo[0x2030][10].raw = samples

    def command(self, value: int) -> None:
        self.sdo[0x2030][1].raw = value

    def begin(self, command: Command = Command.START) -> None:
        self.start()
        self.command(command)

    @property
    def state(self) -> int:
        return self.sdo[0x2030][2].raw

    @property
    def reason(self) -> str:
        return list(Reason)[self.sdo[0x2030][7].raw]

    def figures(self) -> list[float]:
        """Residual rms and peak, drift rms and peak, cycles."""
        return [self.sdo[0x2030][subindex].raw for subindex in (5, 6, 8, 9)]

    def conditioning(self) -> tuple[float, ...]:
        return tuple(self.sdo[0x2002][subindex].raw for subindex in range(1, 6))

    @property
    def is_calibrating(self) -> bool:
        return bool(self.sdo[0x2011][1].raw & StatusBit.CALIBRATING)

    def feed(self, samples: Iterable[Counts | None]) -> list[tuple[int, int, int]]:
        """One SYNC each with its sample, or without; the position PDOs that came."""
        published = []
        for counts in samples:
            frames = self.sync()
            if counts is not None:
                frames += self.counts(*counts)
            published += [self.position([frame]) for frame in frames if frame.can_id == 0x1A0]
        return published

    def compute(self) -> Outcome:
        """Do the pending job, here."""
        job = self.module.pending_job()
        assert job is not None
        result = job()
        assert self.module.finish_job(job, result, self.bus.now) == []
        return result

    def finish_with(self, result: Outcome | Exception) -> None:
        job = self.module.pending_job()
        assert job is not None
        self.module.finish_job(job, result, self.bus.now)

    def ready(self, command: Command = Command.START) -> Outcome:
        """At the end of a measurement of ENCODER."""
        self.begin(command)
        self.feed([(0, 1500)] * 5)
        self.command(Command.FINISH)
        self.finish_with(good_outcome())
        assert self.state == (State.CHECKED if command == Command.CHECK else State.READY)
        return good_outcome()
