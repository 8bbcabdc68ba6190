"""The classes of faults that the campaign runs, each with sizes drawn at random."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from canfb.planning.coverage import KINDS
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

    def length(self, rng: Rng) -> int | None:
        """Samples that one fault lasts; None: to the end of the episode."""
        if self.samples is not None:
            return self.samples
        return int(rng.integers(1, LONGEST_SHORT + 1)) if rng.uniform() < 0.5 else None


def _computed(name: str) -> FaultClass:
    """One of those that `canfb plan --coverage` computes, drawn in the same way."""
    draw = KINDS[name]
    assert draw is not None
    return FaultClass(name, lambda rng: draw(rng, A))


def _any_track(rng: Rng) -> Signal:
    return (Signal.SINE, Signal.COSINE, Signal.BOTH)[int(rng.integers(3))]


def _short(rng: Rng) -> Fault:
    return faults.shorted_track(_any_track(rng), bool(rng.uniform() < 0.5))


def _noise(rng: Rng) -> Fault:
    return faults.excess_noise(_any_track(rng), float(rng.uniform(0.03, 1.0)) * A)


def _phase_glitch(rng: Rng) -> Fault:
    return faults.phase_glitch(A, common=bool(rng.uniform() < 0.5))


CLASSES: tuple[FaultClass, ...] = (
    FaultClass("sine open", lambda rng: faults.open_track(Signal.SINE, float(rng.uniform(0.0, 5.0)))),
    FaultClass("cosine open", lambda rng: faults.open_track(Signal.COSINE, float(rng.uniform(0.0, 5.0)))),
    _computed("both open"),
    FaultClass("short to a supply", _short),
    *(_computed(name) for name in ("stuck at a value", "stuck at the last value", "tracks joined")),
    *(_computed(name) for name in ("tracks swapped", "one track inverted", "both inverted")),
    *(_computed(name) for name in ("offset drift", "gain drift", "phase drift", "oscillation")),
    FaultClass("excess noise", _noise),
    *(FaultClass(f"phase glitch, {n}", _phase_glitch, n) for n in (1, 2, 3)),
    *(FaultClass(f"random counts, {n}", lambda _: faults.count_glitch(), n) for n in (1, 2, 3)),
    FaultClass("random counts", lambda _: faults.count_glitch()),
    *(FaultClass(f"lost, {n}", lambda _: faults.lost_samples(), n) for n in (1, 2, 3)),
    FaultClass("lost", lambda _: faults.lost_samples()),
    *(FaultClass(f"repeated, {n}", lambda _: faults.frozen_samples(), n) for n in (1, 2, 3)),
    FaultClass("repeated every other", lambda _: faults.repeated_samples()),
    _computed("frozen"),
    *(FaultClass(f"late, {n}", lambda _: faults.late_samples(), n) for n in (1, 2, 3)),
    FaultClass("late", lambda _: faults.late_samples()),
)  # fmt: skip
