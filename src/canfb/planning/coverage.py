"""Diagnostic coverage: the part of encoder faults that the configured limits detect.

:func:`area_coverage` is 1 - allowed area / whole area of the voltages: the amplitude limits allow a ring, and
the residual limit L only its phases within L of the predicted one. :func:`fault_coverage` injects the
faults of IEC 61800-5-2 into the tracks of a machine in motion, regardless of the ambiguity after a fault and
of 2010:04.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from canfb import objects as od
from canfb.planning.plan import ResidualBudget
from canfb.signal.bounded_motion import ORDER
from canfb.signal.phase import BoolArray, FloatArray
from canfb.signal.supervision import SampleLimits
from canfb.simulation.faults import (
    Fault,
    Rng,
    Samples,
    Signal,
    frozen_samples,
    inverted_tracks,
    joined_tracks,
    open_track,
    oscillation,
    shorted_track,
    stuck_track,
    swapped_tracks,
    track_drift,
)
from canfb.view.module_view import mapped_objects

CASES = 400  # cases of each fault
FAULTY_SAMPLES = 200  # duration of a fault, as in docs/evidence.md
HARM_CYCLES = 0.25
LONGEST_RAMP = 200
SEED = 61800
USUAL_TOLERANCE = 0.01  # of a second position, revolutions, as in docs/homing.md
LEAST_MOTION_CYCLES = 0.01  # acceleration if no motion is given, cycles per interval^2
SECOND = od.SAMPLE_SECOND_POSITION.mapped(32)


@dataclass(frozen=True, kw_only=True)
class SampleWindow:
    """The limits that samples are checked against.

    sample                      limits of amplitude and converter range
    nominal_counts              amplitude of the healthy tracks
    limit_cycles                residual limit L
    motion_cycles               largest acceleration, cycles per interval^2
    tolerance_cycles            of the second position
    """

    sample: SampleLimits
    nominal_counts: float
    limit_cycles: float
    motion_cycles: float
    tolerance_cycles: float


class Shares(NamedTuple):
    """Part detected, 0..1: by amplitude and converter range, with the residual, with a second position."""

    amplitude: float
    residual: float
    second_position: float


@dataclass(frozen=True)
class FaultCoverage:
    """Detection of the harmful faults of one kind, which shift phase or position by more than 0.25 cycle.

    harmful     their number, of ``CASES``
    within      samples until amplitude or residual show 99 % of the faults that they detect; None: none
    """

    name: str
    harmful: int
    shares: Shares
    within: int | None


def window_of(budget: ResidualBudget) -> SampleWindow:
    """The limits of a module; without a second position a tolerance of 0.01 revolution is assumed."""
    settings, tolerance = budget.module.settings, second_tolerance(budget) or USUAL_TOLERANCE
    return SampleWindow(
        sample=settings.sample,
        nominal_counts=budget.plan.amplitude * settings.sample.full_scale_counts,
        limit_cycles=budget.limit_cycles,
        motion_cycles=min(budget.motion_cycles or LEAST_MOTION_CYCLES, budget.limit_cycles),
        tolerance_cycles=tolerance * settings.cycles_per_revolution,
    )


def second_tolerance(budget: ResidualBudget) -> float | None:
    """2014:04, revolutions; None if the module receives no second position."""
    values = budget.module.values
    tolerance = float(values.get(od.SECOND_TOLERANCE, 0.0))
    return tolerance if tolerance and SECOND in mapped_objects(values.get) else None


def area_coverage(window: SampleWindow) -> Shares:
    """Coverage for voltages anywhere in the range of the converter."""
    full = float(window.sample.full_scale_counts)
    ring = (
        _disc(window.sample.amplitude_high_counts, full) - _disc(window.sample.amplitude_low_counts, full)
    ) / (4.0 * full * full)
    left = min(1.0, 2.0 * window.limit_cycles)
    near = min(left, 2.0 * window.tolerance_cycles)
    return Shares(1.0 - ring, 1.0 - ring * left, 1.0 - ring * near)


def _disc(radius: float, half_side: float) -> float:
    if radius <= half_side:
        return math.pi * radius * radius
    if radius >= math.sqrt(2.0) * half_side:
        return 4.0 * half_side * half_side
    inside = math.acos(half_side / radius)
    return radius * radius * (math.pi - 4.0 * inside) + 4.0 * half_side * radius * math.sin(inside)


@cache  # equal modules have equal windows
def fault_coverage(window: SampleWindow) -> list[FaultCoverage]:
    """Coverage of each kind of fault, at all phases and speeds; a function of ``window`` alone."""
    return [_covered(window, name, draw) for name, draw in KINDS.items()]


def _covered(window: SampleWindow, name: str, draw: Callable[[Rng, float], Fault] | None) -> FaultCoverage:
    rng = np.random.default_rng([SEED, list(KINDS).index(name)])
    total = ORDER + FAULTY_SAMPLES
    truth = np.stack([_motion(window, total, rng) for _ in range(CASES)])
    # Fault of the coupling: the encoder continues at its last speed.
    clean = truth if draw is not None else truth[:, :1] + np.arange(total) * np.diff(truth[:, :2])
    angle = 2.0 * np.pi * clean
    sine, cosine = (np.rint(window.nominal_counts * track(angle)) for track in (np.sin, np.cos))
    if draw is not None:
        for case in range(CASES):
            samples = Samples(
                sine[case].astype(np.int64),
                cosine[case].astype(np.int64),
                np.ones(total, dtype=np.bool_),
                window.sample.full_scale_counts,
            )
            bad = draw(rng, window.nominal_counts).inject(samples, ORDER, total, rng)
            sine[case], cosine[case] = bad.sine, bad.cosine
    return _judged(window, name, truth, sine, cosine)


def _motion(window: SampleWindow, total: int, rng: Rng) -> FloatArray:
    """True positions, cycles; accelerated from the fault on.

    Eq. 9 does not depend on whole cycles per interval, so the speed is within half a cycle.
    """
    k = np.arange(total) - ORDER + 1.0
    high = float(rng.uniform(-1.0, 1.0)) * window.motion_cycles
    bend = np.where(k > 0.0, k * (k + 1.0) / 2.0, 0.0)
    return np.asarray(float(rng.uniform()) + float(rng.uniform(-0.5, 0.5)) * k + high * bend, np.float64)


def _judged(
    window: SampleWindow, name: str, truth: FloatArray, sine: FloatArray, cosine: FloatArray
) -> FaultCoverage:
    full = window.sample.full_scale_counts
    amplitude = np.hypot(sine, cosine)
    refused = (amplitude < window.sample.amplitude_low_counts) | (
        amplitude > window.sample.amplitude_high_counts
    )
    for track in (sine, cosine):
        refused |= (track <= -full) | (track >= full - 1)
    phase = np.arctan2(sine, cosine) / (2.0 * np.pi)
    change = np.diff(phase, ORDER, axis=1)
    residual = change - np.rint(change)
    error: FloatArray = residual - np.diff(truth, ORDER, axis=1)
    for _ in range(ORDER):
        error = np.cumsum(error, axis=1)
    by_amplitude = refused[:, ORDER:]
    by_residual: Any = by_amplitude | (np.abs(residual) > window.limit_cycles)
    moved = phase - truth
    moved -= np.rint(moved)
    harmful: Any = ((np.abs(moved[:, ORDER:]) > HARM_CYCLES) | (np.abs(error) > HARM_CYCLES)).any(axis=1)
    second = by_residual | (np.abs(error) > window.tolerance_cycles)
    detected = [np.any(seen, axis=1)[harmful] for seen in (by_amplitude, by_residual, second)]
    shares = Shares(*(float(part.mean()) if harmful.any() else 1.0 for part in detected))
    return FaultCoverage(name, int(harmful.sum()), shares, _within(by_residual[harmful]))


def _within(detected: BoolArray) -> int | None:
    first = [int(np.argmax(one)) + 1 for one in detected if one.any()]
    return int(np.quantile(first, 0.99, method="higher")) if first else None


def _one(rng: Rng) -> Signal:
    return Signal.SINE if rng.uniform() < 0.5 else Signal.COSINE


def _sign(rng: Rng) -> float:
    return 1.0 if rng.uniform() < 0.5 else -1.0


def _ramp(rng: Rng) -> int:
    return int(rng.integers(20, LONGEST_RAMP + 1))


def _drift(rng: Rng, what: str, size: float) -> Fault:
    ramp = _ramp(rng)
    track = "sine" if _one(rng) is Signal.SINE else "cosine"
    return track_drift(**{f"{track}_{what}": size}, ramp_samples=ramp)


def _oscillation(rng: Rng, nominal: float) -> Fault:
    signal = (Signal.SINE, Signal.COSINE, Signal.BOTH)[int(rng.integers(3))]
    size, rate = float(rng.uniform(0.1, 1.2)) * nominal, float(rng.uniform(0.0, 0.5))
    return oscillation(signal, size, rate, float(rng.uniform(0.0, 2.0 * math.pi)))


# Kinds of faults: a function that draws one for a nominal amplitude, counts. None: not a fault of the tracks.
KINDS: dict[str, Callable[[Rng, float], Fault] | None] = {
    "one track open": lambda rng, nominal: open_track(_one(rng), float(rng.uniform(0.0, 5.0))),
    "both open": lambda rng, nominal: open_track(Signal.BOTH, float(rng.uniform(0.0, 5.0))),
    "short to a supply": lambda rng, nominal: shorted_track(_one(rng), bool(rng.uniform() < 0.5)),
    "tracks joined": lambda rng, nominal: joined_tracks(),
    "stuck at a value": lambda rng, nominal: stuck_track(_one(rng), float(rng.uniform(-nominal, nominal))),
    "stuck at the last value": lambda rng, nominal: stuck_track(_one(rng)),
    "frozen": lambda rng, nominal: frozen_samples(),
    "offset drift": lambda rng, nominal: _drift(
        rng, "offset", float(rng.uniform(0.3, 1.5)) * nominal * _sign(rng)
    ),
    "gain drift": lambda rng, nominal: _drift(rng, "gain", float(rng.uniform(-0.2, 1.4))),
    "phase drift": lambda rng, nominal: track_drift(
        phase_rad=float(rng.uniform(0.1, 1.0)) * math.pi * _sign(rng), ramp_samples=_ramp(rng)
    ),
    "oscillation": _oscillation,
    "tracks swapped": lambda rng, nominal: swapped_tracks(),
    "one track inverted": lambda rng, nominal: inverted_tracks(_one(rng)),
    "both inverted": lambda rng, nominal: inverted_tracks(Signal.BOTH),
    "coupling lost": None,
}
