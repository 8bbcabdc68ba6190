"""The plant of the fault campaign: encoder, table, limits, and motions at every kind of speed."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from canfb import AdaptConfig, CorrectionTable, SignalChain, phase_in_cycle
from canfb.calibration.ellipse import with_track_harmonics
from canfb.signal.adaptation import FollowedDrift
from canfb.signal.chain_config import ChainConfig
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.declared import DOUBT_ACCELERATION
from canfb.signal.sample import Sample
from canfb.simulation.encoder import Encoder, demo_encoder
from tools.faults.machine import TOP_CYCLES, Array, Counts, exact_table, on_grid

ENCODER: Encoder = demo_encoder()  # 12 bits, half a count of noise, every error of a mediocre one
RAMP_CYCLES = 0.25  # per interval squared: to get to the speed, before the narrow limits are set
SETTLED_SAMPLES = 20
# As fast as an adaptation can be: the interval is taken for a longer one, so that it learns from each sample.
ADAPT, ADAPT_INTERVAL_S = AdaptConfig(rate_per_hour=10.0), 0.01
ADAPT_SLACK = 0.004  # of a residual: 0.001 cycle of each phase
# Before the first episode it has followed half of what it may.
FOLLOWED = FollowedDrift(0.075 * ENCODER.amplitude_counts, -0.075 * ENCODER.amplitude_counts, 0.12, 0.025)
LONGEST_GLITCH = 3  # of the classes with a number in their name

# Cycles per sample: standstill, creeping, and locked at whole, half and third cycles per sample.
LOCKED = (
    0.0, 0.0, 0.002, -0.002, 0.02, -0.02, 0.15, -0.3, 0.5, -0.5, 1.0, -1.0, 1.5, 10.25, -10.25,
    41.0 + 1.0 / 3.0, -41.0 - 2.0 / 3.0, 62.5, -62.5, 83.0, -83.0, 83.5, -83.25, 124.5, -124.5, TOP_CYCLES,
)  # fmt: skip


@dataclass(frozen=True)
class Setting:
    """Limits of the chain, and what the machine does.

    residual_limit           cycles
    amplitude                lowest and highest, as parts of the nominal one; None: the defaults
    frozen_samples           repeats in a row that are taken for a dead converter; 0: none
    conditioned              offsets, gains and phase error of the tracks are known to the chain
    acceleration             largest of the machine, cycles per interval squared
    adapt                    drift is followed, and half of what is allowed was already
    """

    name: str
    residual_limit: float
    amplitude: tuple[float, float] | None
    frozen_samples: int
    conditioned: bool
    acceleration: float
    adapt: bool = False

    @property
    def slack(self) -> float:
        """The chain's phases are those of what it has learned, the judge's those of the truth; cycles."""
        return ADAPT_SLACK if self.adapt else 0.0

    @cached_property
    def conditioning(self) -> Conditioning:
        if not self.conditioned:
            return IDENTITY
        e = ENCODER
        return Conditioning(
            e.amplitude_counts * e.sine_offset,
            e.amplitude_counts * e.cosine_offset,
            1.0 / e.sine_amplitude,
            1.0 / e.cosine_amplitude,
            e.phase_error_rad,
        )

    @cached_property
    def calibrated(self) -> Conditioning:
        """That of a reference measurement before the drift: with :data:`FOLLOWED` it is that of now."""
        used = now = self.config.conditioning
        for _ in range(20):
            pairs = zip(used.values, now.values, FOLLOWED.removed_by(used).values, strict=True)
            used = Conditioning(*(one + wanted - got for one, wanted, got in pairs))
        return used

    @cached_property
    def table(self) -> CorrectionTable:
        """The table that a reference measurement without error would give."""
        return exact_table(lambda truth: self.conditioning.apply(*ENCODER.tracks(truth)))

    @cached_property
    def config(self) -> ChainConfig:
        low, high = (None, None)
        if self.amplitude is not None:
            low, high = (round(part * ENCODER.amplitude_counts) for part in self.amplitude)
        tracks = np.array(ENCODER.tracks(np.arange(4096) / 4096))
        return ChainConfig(
            amplitude_low_counts=low,
            amplitude_high_counts=high,
            residual_limit=self.residual_limit,
            frozen_samples=self.frozen_samples,
            conditioning=with_track_harmonics(self.conditioning, tracks) if self.adapt else self.conditioning,
            adapt=ADAPT if self.adapt else False,
            interval_s=ADAPT_INTERVAL_S if self.adapt else 0.0,
            bad_samples=LONGEST_GLITCH,
            # It is not known, but what is assumed while in doubt has to hold for the machine.
            doubt_acceleration_cycles=max(DOUBT_ACCELERATION, min(self.acceleration, 0.5)),
        )

    def phases(self, sine: Counts, cosine: Counts) -> tuple[Array, Array]:
        """Corrected phase and amplitude of these counts, as the chain computes them."""
        s, c = self.conditioning.apply(sine.astype(np.float64), cosine.astype(np.float64))
        return self.table(phase_in_cycle(s, c)), np.sqrt(s * s + c * c)


DEFAULT = Setting("default", 1.0 / 3.0, None, 0, False, 0.01)
HARD = Setting("accelerating", 1.0 / 3.0, None, 0, False, 0.2)
COMMISSIONED = Setting("commissioned", 0.06, (0.8, 1.2), 16, True, 0.01)
SETTINGS = (DEFAULT, HARD, COMMISSIONED)  # of the tables of docs/evidence.md


class Turning:
    """A chain that has followed the machine from standstill to a speed, to be copied for each episode.

    position   true position of the last sample, cycles
    offset     true position less published one, whole cycles (the count begins at zero)
    flagged    how often a clean sample was flagged on the way, and it was begun anew
    """

    def __init__(self, setting: Setting, speed: float, rng: np.random.Generator) -> None:
        self.setting = setting
        self.speed = speed
        steps = math.ceil(abs(speed) / RAMP_CYCLES)
        speeds = np.concatenate(
            (np.zeros(5), np.linspace(0.0, speed, steps + 1), np.full(SETTLED_SAMPLES, speed))
        )
        self.flagged = -1
        valid = False
        while not valid:
            self.flagged += 1
            positions = rng.uniform() + np.cumsum(speeds)
            self._chain = _chain_of(setting)
            sine, cosine = ENCODER.sample(positions, rng)
            published = [
                self._chain.step(Sample(s, c)) for s, c in zip(sine.tolist(), cosine.tolist(), strict=True)
            ]
            valid = all(one.valid for one in published)
        self._chain.set_limits(setting.config.chain_limits)
        self.position = float(positions[-1])
        self.offset = round(self.position - published[-1].cycles - published[-1].phase)

    def chain(self) -> SignalChain:
        """A copy of the chain; the table, which nothing changes, is shared."""
        table = self.setting.table
        return copy.deepcopy(self._chain, {id(table): table})


def _chain_of(setting: Setting) -> SignalChain:
    if not setting.adapt:
        return SignalChain(ChainConfig(conditioning=setting.conditioning), setting.table)
    config = ChainConfig(conditioning=setting.calibrated, interval_s=ADAPT_INTERVAL_S)
    chain = SignalChain(config, setting.table)
    chain.adapt(ADAPT, FOLLOWED)
    return chain


def speed_of_group(group: int, rng: np.random.Generator) -> float:
    """Every other group is at one of the locked speeds, the others anywhere up to the top speed."""
    if group % 2 == 0:
        return LOCKED[group // 2 % len(LOCKED)]
    return float(rng.uniform(-TOP_CYCLES, TOP_CYCLES))


def motion(turning: Turning, samples: int, rng: np.random.Generator) -> Array:
    """True positions after those of ``turning``, cycles: one in three at constant speed.

    The others change their acceleration every 20..120 samples; they brake near the top speed.
    """
    acceleration = np.zeros(samples)
    if rng.uniform() > 1.0 / 3.0:
        at, speed = 0, turning.speed
        while at < samples:
            stretch = int(rng.integers(20, 121))
            value = float(rng.uniform(-1.0, 1.0)) * turning.setting.acceleration
            if abs(speed + value * stretch) > TOP_CYCLES:
                value = -math.copysign(value, speed)
            acceleration[at : at + stretch] = value
            speed += value * stretch
            at += stretch
    return on_grid(turning.position, turning.speed, acceleration)
