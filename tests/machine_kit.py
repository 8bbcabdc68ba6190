"""Simulated machines for canfb commission: their truth, their samples, and what a module says of them."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from canfb import objects as od
from canfb.commission.limit_choice import Choice, choose, observe
from canfb.commission.machine_figures import Observation
from canfb.master.machine_watch import SpeedReading
from canfb.master.samples import TrackSamples
from canfb.master.session import SupervisionLimits
from canfb.signal.correction import Correction
from canfb.signal.phase import FloatArray
from canfb.simulation.encoder import Encoder, Motion, Ramp, Ripple
from tools.faults.machine import exact_table

N, RATE_HZ = 2500, 1000.0
BEFORE = {
    od.ENCODER_LOWEST_AMPLITUDE: 410, od.ENCODER_HIGHEST_AMPLITUDE: 2560,
    od.SUPERVISION_RESIDUAL_LIMIT: 21845, od.SUPERVISION_ACCELERATION: 0.0, od.SUPERVISION_FROZEN: 0,
    od.SUPERVISION_COARSE_LIMIT: 2048, od.SUPERVISION_PHASE_ERROR: 819, od.SUPERVISION_PERIODS: 2,
    od.SUPERVISION_SYNC_JITTER: 0.0,
}  # fmt: skip


def duty(top_rpm: float, ramp_s: float, ripples: tuple[Ripple, ...] = ()) -> Motion:
    """Standing, running forwards, standing, running backwards, forty times."""
    one = (
        Ramp(0.2, 0.0), Ramp(ramp_s, top_rpm), Ramp(0.4, top_rpm), Ramp(ramp_s, 0.0),
        Ramp(0.2, 0.0), Ramp(ramp_s, -0.7 * top_rpm), Ramp(0.3, -0.7 * top_rpm), Ramp(ramp_s, 0.0),
    )  # fmt: skip
    return Motion(one * 40, ripples)


def correction_of(encoder: Encoder) -> Correction:
    return Correction(exact_table(encoder.tracks, 512))


@dataclass
class SimulatedMachine:
    """A machine with an encoder; time goes on with each recording."""

    motion: Motion
    encoder: Encoder
    modulation: float = 0.0  # of the amplitude over the revolution
    jitter_s: float = 0.0
    start_s: float = 0.0
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(4))

    @property
    def used(self) -> Correction:
        return correction_of(self.encoder)

    def positions(self, count: int) -> FloatArray:
        times = self.start_s + np.arange(count) / RATE_HZ
        times = np.maximum(times + self.rng.normal(0.0, self.jitter_s, count), 0.0)
        return self.motion.revolutions_at(times) * N

    def samples(self, count: int) -> TrackSamples:
        position = self.positions(count)
        sine, cosine = self.counts(position)
        self.start_s += count / RATE_HZ
        samples = TrackSamples.of(sine, cosine, RATE_HZ, "a simulated machine")
        return replace(samples, received_s=np.arange(count) / RATE_HZ)

    def counts(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """As the encoder gives them, its amplitude changing over the revolution."""
        encoder = self.encoder
        size = 1.0 + self.modulation * np.sin(2.0 * np.pi * position / N)
        noise = self.rng.normal(0.0, encoder.noise_lsb, (2, len(position)))
        full = 1 << (encoder.adc_bits - 1)
        sine, cosine = (
            np.clip(np.rint(track * size + off), -full, full - 1)
            for track, off in zip(encoder.tracks(position), noise, strict=True)
        )
        return sine, cosine

    def readings(self, count: int) -> list[SpeedReading]:
        """What a module would say of its speed during the next samples."""
        at = np.arange(50, count, 97)
        times = self.start_s + at / RATE_HZ
        step = 1e-5
        speed = (self.motion.revolutions_at(times) - self.motion.revolutions_at(times - step)) / step
        return [SpeedReading(float(k), 2.0 * math.pi * float(v)) for k, v in zip(at, speed, strict=True)]

    def observed(self, count: int) -> Observation:
        readings = self.readings(count)
        return observe(self.samples(count), self.used, self.limits, readings)

    @property
    def limits(self) -> SupervisionLimits:
        full = 1 << (self.encoder.adc_bits - 1)
        default = {
            od.ENCODER_FULL_SCALE: full,
            od.ENCODER_LOWEST_AMPLITUDE: round(0.2 * full),
            od.ENCODER_HIGHEST_AMPLITUDE: round(1.25 * full),
        }
        return SupervisionLimits(BEFORE | default | {od.ENCODER_CYCLES_PER_REVOLUTION: N})

    def commissioned(
        self, count: int, margin: float = 2.0, known: float = 0.0
    ) -> tuple[Observation, SupervisionLimits, dict[od.Multiplexer, Choice]]:
        observed = self.observed(count)
        choices = choose(observed, self.limits, margin, known)
        new = self.limits.changed({one.place: one.value for one in choices})
        return observed, new, {one.place: one for one in choices}
