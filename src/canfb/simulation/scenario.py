"""The section ``simulation:`` of the configuration: the encoder and the motion of ``canfb simulate``."""

from __future__ import annotations

import random
from dataclasses import dataclass, field, fields
from typing import Any

from canfb.checks import within
from canfb.interface.encoder_interface import LARGEST_DRIFT_PPM, SampleClock
from canfb.simulation.cia402.plant import DriveConfig
from canfb.simulation.embedded_bus import SyncTiming
from canfb.simulation.encoder import (
    AnalogPath,
    Encoder,
    Harmonic,
    Motion,
    MotionSource,
    Ramp,
    Ripple,
    ShaftEncoder,
    StoppableMotion,
    TrackErrors,
)

PACES = ("time", "sync")


@dataclass(frozen=True, kw_only=True)
class HarmonicConfig:
    """One harmonic of the tracks, relative to the fundamental.

    order    multiple of the track frequency, 2..50
    sine     its amplitude in the sine track, -1..1 of the amplitude
    cosine   its amplitude in the cosine track, -1..1 of the amplitude
    """

    order: int
    sine: float = 0.0
    cosine: float = 0.0

    def __post_init__(self) -> None:
        within(
            self,
            order=(2, 50),
            sine=(-1.0, 1.0),
            cosine=(-1.0, 1.0),
        )


@dataclass(frozen=True, kw_only=True)
class EncoderScenario(AnalogPath, TrackErrors):
    """Errors of the simulated encoder.

    amplitude          of both tracks, 0..2 of the full scale
    sine_offset        zero of the sine track, -1..1 of the amplitude
    cosine_offset      zero of the cosine track, -1..1 of the amplitude
    sine_amplitude     of the sine track, 0..2 of the amplitude
    cosine_amplitude   of the cosine track, 0..2 of the amplitude
    phase_error_rad    deviation of the tracks from a right angle, -1..1
    noise_lsb          rms noise of each sample, 0..1000
    harmonics          of the tracks, each an order and its amplitudes
    sine_corner_hz     corner frequency of the low-pass of the sine track, 0..1e9; 0: none
    cosine_corner_hz   the same for the cosine track, 0..1e9; 0: none
    cosine_delay_s     delay of the cosine sample after the sine, -0.01..0.01
    delay_s            delay of both tracks, -0.01..0.01
    """

    amplitude: float = 0.75
    noise_lsb: float = 0.5
    harmonics: list[HarmonicConfig] = field(default_factory=list)

    def __post_init__(self) -> None:
        within(
            self,
            amplitude=(0.0, 2.0),
            sine_offset=(-1.0, 1.0),
            cosine_offset=(-1.0, 1.0),
            sine_amplitude=(0.0, 2.0),
            cosine_amplitude=(0.0, 2.0),
            phase_error_rad=(-1.0, 1.0),
            noise_lsb=(0.0, 1000.0),
            sine_corner_hz=(0.0, 1e9),
            cosine_corner_hz=(0.0, 1e9),
            cosine_delay_s=(-0.01, 0.01),
            delay_s=(-0.01, 0.01),
        )

    def encoder(self, adc_bits: int) -> Encoder:
        return Encoder(
            amplitude_counts=self.amplitude * (1 << (adc_bits - 1)),
            **{one.name: getattr(self, one.name) for one in fields(TrackErrors)},
            harmonics=tuple(Harmonic(h.order, h.sine, h.cosine) for h in self.harmonics),
            adc_bits=adc_bits,
            noise_lsb=self.noise_lsb,
            path=AnalogPath(**{one.name: getattr(self, one.name) for one in fields(AnalogPath)}),
        )


@dataclass(frozen=True, kw_only=True)
class MotionConfig:
    """Standstill, a ramp up to ``rpm``, then that speed, all with a ripple.

    rpm            speed after the ramp, -1e6..1e6
    standstill_s   before the ramp, 0..1e6
    ramp_s         duration of the ramp, 0..1e6
    ripple_rpm     amplitude of the ripple, -1e6..1e6; 0: none
    ripple_hz      frequency of the ripple, 1e-6..1e6
    """

    rpm: float = 60.0
    standstill_s: float = 0.5
    ramp_s: float = 2.0
    ripple_rpm: float = 0.0
    ripple_hz: float = 1.0

    def __post_init__(self) -> None:
        within(
            self,
            rpm=(-1e6, 1e6),
            standstill_s=(0.0, 1e6),
            ramp_s=(0.0, 1e6),
            ripple_rpm=(-1e6, 1e6),
            ripple_hz=(1e-6, 1e6),
        )

    def motion(self) -> Motion:
        return Motion(
            (Ramp(self.standstill_s, 0.0), Ramp(self.ramp_s, self.rpm)),
            (Ripple(self.ripple_rpm, self.ripple_hz),) if self.ripple_rpm else (),
        )


@dataclass(frozen=True, kw_only=True)
class SimulationConfig(SyncTiming):
    """What ``canfb simulate`` plays; a ``drive`` makes its own motion.

    The fields of SyncTiming     timing of the SYNC of ``--rate``
    encoder                      the encoder and its errors
    motion                       of the machine
    drive                        a CiA 402 drive that moves the machine instead of ``motion``; None: none
    clock_drift_ppm              rate error of the interface's clock for sample times (2000:01), -10000..10000
                                 ppm, positive: fast
    aperture_jitter_ns           rms jitter of the sampling instant, 0..1e6 ns
    pace                         "time": the machine turns in true time; "sync": by one interval per SYNC,
                                 however late (:mod:`canfb.interface.encoder_interface`)
    sync_period_us               of the SYNC of the bus, 10..1e7 us; ``--rate`` takes precedence
    seed                         of all random numbers, 0..2^63 - 1
    """

    encoder: EncoderScenario = field(default_factory=EncoderScenario)
    motion: MotionConfig = field(default_factory=MotionConfig)
    drive: DriveConfig | None = None
    clock_drift_ppm: float = 0.0
    aperture_jitter_ns: float = 0.0
    pace: str = PACES[0]
    sync_period_us: float = 1000.0
    seed: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        within(
            self,
            clock_drift_ppm=(-LARGEST_DRIFT_PPM, LARGEST_DRIFT_PPM),
            aperture_jitter_ns=(0.0, 1e6),
            sync_period_us=(10.0, 1e7),
            seed=(0, 2**63 - 1),
        )
        if self.pace not in PACES:
            raise ValueError(f"pace must be {' or '.join(PACES)}, not {self.pace!r}")

    def source(self, adc_bits: int, cycles_per_revolution: int, interval_s: float) -> MotionSource:
        motion = StoppableMotion(self.motion.motion(), self.motion.ramp_s)
        return MotionSource(self.shaft(adc_bits, cycles_per_revolution), motion, interval_s)

    def shaft(self, adc_bits: int, cycles_per_revolution: int) -> ShaftEncoder:
        encoder = self.encoder.encoder(adc_bits)
        return ShaftEncoder(encoder, cycles_per_revolution, self.seed, self.aperture_jitter_ns * 1e-9)

    def sample_clock(self) -> SampleClock:
        return SampleClock(self.clock_drift_ppm, random.Random(self.seed).getrandbits(32))


# The class of each key of the section.
SECTION: dict[str, Any] = {
    "simulation": SimulationConfig,
    "encoder": EncoderScenario,
    "motion": MotionConfig,
    "harmonics": [HarmonicConfig],
    "drive": DriveConfig,
}
