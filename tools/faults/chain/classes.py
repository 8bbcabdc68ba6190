"""The classes of faults that the campaign runs, each with sizes drawn at random."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from canfb.simulation import faults
from canfb.simulation.faults import Fault, Signal
from tools.faults.chain.plant import ENCODER

Rng = np.random.Generator
A = ENCODER.amplitude_counts
LONGEST_SHORT = 60


@dataclass(frozen=True)
class FaultClass:
    """A class of faults: how to draw one, and how many samples it lasts.

    ``samples``: fixed length, or None: 1..60 samples or to the end of the episode, half and half.
    """

    name: str
    draw: Callable[[Rng], Fault]
    samples: int | None = None

    @property
    def is_glitch(self) -> bool:
        """At most three samples: it must not cost a cycle."""
        return self.samples is not None and self.samples <= 3

    def length(self, rng: Rng) -> int | None:
        """Samples that one fault lasts; None: to the end of the episode."""
        if self.samples is not None:
            return self.samples
        return int(rng.integers(1, LONGEST_SHORT + 1)) if rng.uniform() < 0.5 else None


def _one_track(rng: Rng) -> Signal:
    return Signal.SINE if rng.uniform() < 0.5 else Signal.COSINE


def _any_track(rng: Rng) -> Signal:
    return (Signal.SINE, Signal.COSINE, Signal.BOTH)[int(rng.integers(3))]


def _offset_drift(rng: Rng) -> Fault:
    size = float(rng.uniform(0.3, 1.5)) * A * float(rng.choice((-1.0, 1.0)))
    ramp = int(rng.integers(20, 201))
    if _one_track(rng) is Signal.SINE:
        return faults.TrackDrift(sine_offset=size, ramp_samples=ramp)
    return faults.TrackDrift(cosine_offset=size, ramp_samples=ramp)


def _gain_drift(rng: Rng) -> Fault:
    gain, ramp = float(rng.uniform(-0.2, 1.4)), int(rng.integers(20, 201))
    if _one_track(rng) is Signal.SINE:
        return faults.TrackDrift(sine_gain=gain, ramp_samples=ramp)
    return faults.TrackDrift(cosine_gain=gain, ramp_samples=ramp)


def _phase_drift(rng: Rng) -> Fault:
    size = float(rng.uniform(0.1, 1.0)) * math.pi * float(rng.choice((-1.0, 1.0)))
    return faults.TrackDrift(phase_rad=size, ramp_samples=int(rng.integers(20, 201)))


def _oscillation(rng: Rng) -> Fault:
    size = float(rng.uniform(0.1, 1.2)) * A
    return faults.Oscillation(
        _any_track(rng), size, float(rng.uniform(0.0, 0.5)), float(rng.uniform(0.0, 2.0 * math.pi))
    )


def _phase_glitch(rng: Rng) -> Fault:
    return faults.PhaseGlitch(A, common=bool(rng.uniform() < 0.5))


def _stuck(rng: Rng) -> Fault:
    return faults.StuckTrack(_one_track(rng), float(rng.uniform(-A, A)))


def _short(rng: Rng) -> Fault:
    return faults.ShortedTrack(_any_track(rng), bool(rng.uniform() < 0.5))


def _noise(rng: Rng) -> Fault:
    return faults.ExcessNoise(_any_track(rng), float(rng.uniform(0.03, 1.0)) * A)


CLASSES: tuple[FaultClass, ...] = (
    FaultClass("sine open", lambda rng: faults.OpenTrack(Signal.SINE, float(rng.uniform(0.0, 5.0)))),
    FaultClass("cosine open", lambda rng: faults.OpenTrack(Signal.COSINE, float(rng.uniform(0.0, 5.0)))),
    FaultClass("both open", lambda rng: faults.OpenTrack(Signal.BOTH, float(rng.uniform(0.0, 5.0)))),
    FaultClass("short to a supply", _short),
    FaultClass("stuck at a value", _stuck),
    FaultClass("stuck at the last value", lambda rng: faults.StuckTrack(_one_track(rng))),
    FaultClass("tracks joined", lambda _: faults.JoinedTracks()),
    FaultClass("tracks swapped", lambda _: faults.SwappedTracks()),
    FaultClass("one track inverted", lambda rng: faults.InvertedTracks(_one_track(rng))),
    FaultClass("both inverted", lambda _: faults.InvertedTracks(Signal.BOTH)),
    FaultClass("offset drift", _offset_drift),
    FaultClass("gain drift", _gain_drift),
    FaultClass("phase drift", _phase_drift),
    FaultClass("oscillation", _oscillation),
    FaultClass("excess noise", _noise),
    *(FaultClass(f"phase glitch, {n}", _phase_glitch, n) for n in (1, 2, 3)),
    *(FaultClass(f"random counts, {n}", lambda _: faults.CountGlitch(), n) for n in (1, 2, 3)),
    FaultClass("random counts", lambda _: faults.CountGlitch()),
    *(FaultClass(f"lost, {n}", lambda _: faults.LostSamples(), n) for n in (1, 2, 3)),
    FaultClass("lost", lambda _: faults.LostSamples()),
    *(FaultClass(f"repeated, {n}", lambda _: faults.FrozenSamples(), n) for n in (1, 2, 3)),
    FaultClass("repeated every other", lambda _: faults.RepeatedSamples()),
    FaultClass("frozen", lambda _: faults.FrozenSamples()),
    *(FaultClass(f"late, {n}", lambda _: faults.LateSamples(), n) for n in (1, 2, 3)),
    FaultClass("late", lambda _: faults.LateSamples()),
)  # fmt: skip
