"""Faults of the tracks of a mediocre encoder with a correction table.

Each kind draws its parameters at random. A fault counts (``matters``) if it shifts the phase by more than
0.25 cycle, makes it missing, or if a wrong position was valid.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from canfb import AdaptConfig, ChainConfig, CorrectionTable, SignalChain, phase_in_cycle
from canfb.calibration.ellipse import with_track_harmonics
from canfb.planning.coverage import KINDS as COMPUTED
from canfb.signal.adaptation import FollowedDrift
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.limits import DOUBT_ACCELERATION
from canfb.simulation import faults
from canfb.simulation.encoder import Encoder, demo_encoder
from canfb.simulation.faults import Fault, Samples, Signal
from tools.faults.machine import Array, Counts, Rng, accelerations, exact_table, positions, start_speeds
from tools.faults.samples.episodes import VALID, Declared, Episode, Published, State
from tools.faults.samples.judge import Verdict, judge

ENCODER: Encoder = demo_encoder()
A = ENCODER.amplitude_counts
BEFORE, CLEAN_AFTER, TO_THE_END = (100, 301), 100, 200  # samples before, after and during (if to the end)
LONGEST_SHORT = 60
CREEPING = (0.0, 0.0, 0.002, 0.02, 0.15, 0.3)  # speeds of one machine in four, cycles per sample
FLAGGED = 1 << 4 | 1 << 5 | 1 << 6 | 1 << 11  # amplitude, clipped, missed, frozen
SOON_SAMPLES = 3
# The fastest adaptation; a long interval is pretended, so that it learns from each sample.
ADAPT, ADAPT_INTERVAL_S = AdaptConfig(rate_per_hour=10.0), 0.01
ADAPT_SLACK = 0.004  # allowance of a residual: 4 x 0.001 cycle of a phase
# Drift at the begin of an episode: half of the permitted one.
FOLLOWED = FollowedDrift(0.075 * A, -0.075 * A, 0.12, 0.025)


@dataclass(frozen=True)
class Setting(Declared):
    """Limits of the chain, and acceleration of the machine. Only its phases decide whether a motion is legal.

    residual_limit           cycles
    amplitude                lowest and highest, relative to the nominal one; None: the defaults
    frozen_samples           successive repeats that indicate a frozen converter; 0: off
    conditioned              the chain knows offsets, gains and phase error of the tracks
    adapt                    the chain adapts to drift, and has followed half of the permitted one
    """

    phase_error: float = 0.0
    residual_limit: float = 1.0 / 3.0
    amplitude: tuple[float, float] | None = None
    frozen_samples: int = 0
    conditioned: bool = False
    adapt: bool = False
    wrong_cycles: ClassVar[float] = 0.25

    @property
    def bound(self) -> float:
        """The residual limit; with adaptation wider, as its phases differ from those of the judge."""
        return self.residual_limit + (ADAPT_SLACK if self.adapt else 0.0)

    @cached_property
    def conditioning(self) -> Conditioning:
        if not self.conditioned:
            return IDENTITY
        e = ENCODER
        gains = 1.0 / e.sine_amplitude, 1.0 / e.cosine_amplitude
        return Conditioning(A * e.sine_offset, A * e.cosine_offset, *gains, e.phase_error_rad)

    @cached_property
    def calibrated(self) -> Conditioning:
        """Conditioning before the drift: together with :data:`FOLLOWED` it gives the present one."""
        used = now = self.config.conditioning
        for _ in range(20):
            pairs = zip(used.values, now.values, FOLLOWED.removed_by(used).values, strict=True)
            used = Conditioning(*(one + wanted - got for one, wanted, got in pairs))
        return used

    @cached_property
    def table(self) -> CorrectionTable:
        """The table of an error-free reference measurement."""
        return exact_table(lambda truth: self.conditioning.apply(*ENCODER.tracks(truth)))

    @cached_property
    def config(self) -> ChainConfig:
        low, high = (None, None) if self.amplitude is None else (round(part * A) for part in self.amplitude)
        tracks = np.array(ENCODER.tracks(np.arange(4096) / 4096))
        return ChainConfig(
            amplitude_low_counts=low,
            amplitude_high_counts=high,
            residual_limit=self.residual_limit,
            frozen_samples=self.frozen_samples,
            conditioning=with_track_harmonics(self.conditioning, tracks) if self.adapt else self.conditioning,
            adapt=ADAPT if self.adapt else False,
            interval_s=ADAPT_INTERVAL_S if self.adapt else 0.0,
            bad_samples=3,
            # The acceleration is not declared, but the one assumed while in doubt must hold for the machine.
            doubt_acceleration_cycles=max(DOUBT_ACCELERATION, min(self.acceleration, 0.5)),
        )

    def chain(self) -> SignalChain:
        if not self.adapt:
            return SignalChain(self.config, self.table)
        config = ChainConfig(conditioning=self.calibrated, interval_s=ADAPT_INTERVAL_S)
        chain = SignalChain(config, self.table)
        chain.adapt(ADAPT, FOLLOWED)
        chain.set_limits(self.config.chain_limits)
        return chain

    def phases(self, sine: Counts, cosine: Counts) -> tuple[Array, Array]:
        """Corrected phase and amplitude of these counts, computed as in the chain."""
        s, c = self.conditioning.apply(sine.astype(np.float64), cosine.astype(np.float64))
        return self.table(phase_in_cycle(s, c)), np.sqrt(s * s + c * c)

    def is_legal(self, episode: Episode) -> bool:
        """Whether a healthy machine can give all these samples: no supervision can flag them."""
        limits, inside = self.config.limits, episode.state == State.GOOD
        for track in (episode.sine, episode.cosine):
            inside &= (track > -limits.full_scale_counts) & (track < limits.full_scale_counts - 1)
        _, amplitude = self.phases(episode.sine, episode.cosine)
        inside &= (amplitude >= limits.amplitude_low_counts) & (amplitude <= limits.amplitude_high_counts)
        c = np.diff(episode.phase, 2)
        inside[2:] &= np.abs(np.rint(c) - c) < self.bound
        return bool(inside[episode.fault :].all())


SETTINGS = {
    "default": Setting(0.01),
    "accelerating": Setting(0.2),
    "commissioned": Setting(
        0.01, residual_limit=0.06, amplitude=(0.8, 1.2), frozen_samples=16, conditioned=True
    ),
}


@dataclass(frozen=True)
class TrackFault:
    """A fault of ``samples`` duration; None: 1..60 samples or to the end of the episode, equally likely."""

    draw: Callable[[Rng], Fault]
    samples: int | None = None

    def length(self, rng: Rng) -> int | None:
        if self.samples is not None:
            return self.samples
        return int(rng.integers(1, LONGEST_SHORT + 1)) if rng.uniform() < 0.5 else None


def draw(kind: TrackFault, setting: Setting, episodes: int, rng: Rng) -> Iterator[Episode]:
    """Episodes: clean samples, a fault, and clean samples again unless it lasts to the end."""
    at = rng.integers(*BEFORE, episodes)
    samples = BEFORE[1] + TO_THE_END
    u = accelerations(setting.acceleration, rng, at, samples)
    u *= rng.uniform(size=(episodes, 1)) >= 1.0 / 3.0
    speed = start_speeds(rng, episodes, setting.acceleration * samples)
    creeping = rng.choice(CREEPING, episodes) * rng.choice((-1.0, 1.0), episodes)
    speed = np.where(rng.uniform(size=episodes) < 0.25, creeping, speed)
    motions = positions(u, speed, rng)
    for start, motion, first_speed in zip(at.tolist(), motions, speed.tolist(), strict=True):
        yield _episode(kind, setting, start, motion, first_speed, rng)


def _episode(
    kind: TrackFault, setting: Setting, start: int, motion: Array, speed: float, rng: Rng
) -> Episode:
    length = kind.length(rng)
    stop = start + (TO_THE_END if length is None else length)
    truth = motion[: stop if length is None else stop + CLEAN_AFTER]
    clean = Samples.of(*ENCODER.sample(truth, rng), adc_bits=ENCODER.adc_bits)
    bad = kind.draw(rng).inject(clean, start, stop, rng)
    state = np.where(bad.delivered, State.GOOD, State.MISSING).astype(np.int8)
    phase, _ = setting.phases(bad.sine, bad.cosine)
    return Episode(
        setting, start, np.arange(float(len(truth))), truth, bad.sine, bad.cosine, phase, state, speed
    )


def judge_tracks(setting: Setting, episode: Episode, published: Published) -> tuple[Verdict, dict[str, int]]:
    """The verdict on an episode, and

    declared        the number of successive bad, unflagged samples was harmless, and no missing or flagged
                    ones are next to them (docs/supervision.md)
    seen, soon      the fault was flagged; within three samples
    legal           it was not flagged, and a healthy machine can give these samples
    """
    start, status = episode.fault, published.status
    flagged = (status & FLAGGED) != 0
    verdict = judge(replace(episode, state=np.where(flagged, State.FLAGGED, episode.state)), published)
    away = np.abs(episode.phase - episode.truth - np.rint(episode.phase - episode.truth))
    off = np.where(episode.state == State.MISSING, np.nan, away)
    limits = setting.config.chain_limits
    bad = np.flatnonzero((off > limits.phase_error) & ~flagged)
    most = replace(limits, bad=0).bad_samples
    unseen = np.flatnonzero((status[start:] & VALID) == 0)
    matters = not (off[start:] <= setting.wrong_cycles).all() or bool(verdict.wrong)
    seen, declared = len(unseen) > 0, True
    if len(bad):
        beside = (flagged | np.isnan(off))[bad[0] - most - 1 : bad[-1] + most + 2]
        declared = int(bad[-1] - bad[0]) < most and not beside.any()
    return verdict, {
        "declared": declared,
        "matters": matters,
        "seen": matters and seen,
        "soon": seen and int(unseen[0]) <= SOON_SAMPLES,
        "legal": matters and not seen and setting.is_legal(episode),
    }


def excess_noise(signal: Signal, rms_counts: float) -> Fault:
    """Independent Gaussian noise added to both tracks."""
    return faults.changed(
        lambda tracks, full, rng: tracks + rng.normal(0.0, rms_counts, tracks.shape), signal
    )


def phase_glitch(amplitude_counts: float, common: bool = False) -> Fault:
    """Samples of good amplitude at a wrong phase: one random error for all (``common``), or one for each."""

    def change(tracks: Array, full: int, rng: Rng) -> Array:
        angle = rng.uniform(0.0, 2.0 * np.pi, 1 if common else tracks.shape[1])
        if common:
            angle = angle + np.arctan2(*tracks)
        return amplitude_counts * np.stack([np.sin(angle), np.cos(angle)]).astype(np.float64)

    return faults.changed(change)


def count_glitch() -> Fault:
    """Samples of random counts anywhere in the range of the converter."""
    return faults.changed(lambda tracks, full, rng: rng.integers(-full, full, tracks.shape))


def lost_samples() -> Fault:
    def faulty(samples: Samples, span: slice, rng: Rng) -> Samples:
        delivered = samples.delivered.copy()
        delivered[span] = False
        return replace(samples, delivered=delivered)

    return Fault(faulty)


def repeated_samples() -> Fault:
    """Every sample occurs twice, beginning with the last good one: the converter is too slow."""

    def places(span: slice) -> Counts:
        here = np.arange(span.start, span.stop)
        found: Counts = np.maximum(here - (here - span.start + 1) % 2, 0)
        return found

    return faults.moved(places)


def late_samples() -> Fault:
    """Every sample arrives one interval late, which the receiver does not know."""
    return faults.moved(lambda span: np.maximum(np.arange(span.start, span.stop) - 1, faults.last_good(span)))


def _any_track(rng: Rng) -> Signal:
    return (Signal.SINE, Signal.COSINE, Signal.BOTH)[int(rng.integers(3))]


def _nominal(draw: Callable[[Rng, float], Fault]) -> Callable[[Rng], Fault]:
    return lambda rng: draw(rng, A)


def _faults(name: str, draw: Callable[[Rng], Fault], *lengths: int | None) -> dict[str, TrackFault]:
    """A fault for each of these ``lengths``, samples; None: see :class:`TrackFault`."""
    return {name if n is None else f"{name}, {n}": TrackFault(draw, n) for n in lengths}


# The faults of `canfb plan --coverage`, drawn in the same way, and others.
TRACK_FAULTS: dict[str, TrackFault] = {
    **{name: TrackFault(_nominal(drawn)) for name, drawn in COMPUTED.items() if drawn},
    **_faults(
        "short to a supply",
        lambda rng: faults.shorted_track(_any_track(rng), bool(rng.uniform() < 0.5)),
        None,
    ),
    **_faults(
        "excess noise", lambda rng: excess_noise(_any_track(rng), float(rng.uniform(0.03, 1.0)) * A), None
    ),
    **_faults("phase glitch", lambda rng: phase_glitch(A, common=bool(rng.uniform() < 0.5)), 1, 2, 3),
    **_faults("random counts", lambda _: count_glitch(), 1, 2, 3, None),
    **_faults("lost", lambda _: lost_samples(), 1, 2, 3, None),
    **_faults("repeated", lambda _: faults.frozen_samples(), 1, 2, 3),
    **_faults("repeated every other", lambda _: repeated_samples(), None),
    **_faults("late", lambda _: late_samples(), 1, 2, 3, None),
}
