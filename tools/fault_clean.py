"""Clean samples of the fault campaign: how many are flagged although nothing is wrong.

Over arrays: :func:`canfb.process`, and the checks of amplitude, converter and frozen input beside
it. Until the first flagged sample these are the bits of the chain, sample by sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import canfb
from canfb.signal.frozen import REPEATS, SHIFT_CYCLES, STANDSTILL_CYCLES
from fault_judge import HARM_CYCLES
from fault_plant import ENCODER, SETTINGS, TOP_CYCLES, FloatArray, Setting

CHUNK_SAMPLES = 1_000_000
RIPPLE_PART = 0.25  # of the largest acceleration; the ramps have the rest


@dataclass(frozen=True)
class CleanResult:
    """Counts over clean samples: flagged, wrong by more than a quarter of a cycle, largest residual."""

    samples: int = 0
    flagged: int = 0
    wrong: int = 0
    largest_residual: float = 0.0
    largest_speed: float = 0.0

    def merged(self, other: CleanResult) -> CleanResult:
        return CleanResult(
            self.samples + other.samples,
            self.flagged + other.flagged,
            self.wrong + other.wrong,
            max(self.largest_residual, other.largest_residual),
            max(self.largest_speed, other.largest_speed),
        )


def run_clean(seed: int, chunk: int, samples: int) -> CleanResult:
    """One chunk, from standstill on; the settings take turns."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, chunk, 1 << 20]))
    setting = SETTINGS[chunk % len(SETTINGS)]
    truth = clean_motion(setting.acceleration, samples, rng)
    sine, cosine = ENCODER.sample(truth, rng)
    valid, error, residual = judge_clean(setting, sine, cosine, truth)
    return CleanResult(
        samples,
        int(np.count_nonzero(~valid)),
        int(np.count_nonzero(np.abs(error) > HARM_CYCLES)),
        float(residual.max()),
        float(np.abs(np.diff(truth)).max(initial=0.0)),
    )


def clean_motion(acceleration: float, samples: int, rng: np.random.Generator) -> FloatArray:
    """Positions from standstill: ramps and constant speeds up to the top speed, with a ripple on them."""
    accelerations = np.zeros(samples)
    at, speed = 0, 0.0
    while at < samples:
        anywhere = float(rng.uniform(-TOP_CYCLES, TOP_CYCLES))
        target = float(rng.choice((0.0, anywhere, np.rint(anywhere))))
        strength = (1.0 - RIPPLE_PART) * acceleration * float(rng.uniform(0.1, 1.0))
        ramp = max(1, int(np.ceil(abs(target - speed) / strength)))
        accelerations[at : at + ramp] = (target - speed) / ramp
        at += ramp + int(rng.integers(100, 20_000))
        speed = target
    frequency = float(rng.uniform(0.01, 1.0))  # radians per sample
    size = RIPPLE_PART * acceleration / frequency**2
    ripple = size * (1.0 - np.cos(frequency * np.arange(samples)))
    return float(rng.uniform()) + np.cumsum(np.cumsum(accelerations)) + ripple


def judge_clean(
    setting: Setting, sine: npt.NDArray[np.int64], cosine: npt.NDArray[np.int64], truth: FloatArray
) -> tuple[npt.NDArray[np.bool_], FloatArray, FloatArray]:
    """VALID of every sample, the error of its position, and its residual, both in cycles."""
    result = canfb.process(sine, cosine, setting.table, setting.residual_limit, setting.conditioning)
    limits = setting.config.limits
    s, c = setting.conditioning.apply(sine.astype(np.float64), cosine.astype(np.float64))
    amplitude = np.sqrt(s * s + c * c)
    valid = result.ok & (amplitude >= limits.amplitude_low_counts)
    valid &= amplitude <= limits.amplitude_high_counts
    for track in (sine, cosine):
        valid &= (track > -limits.full_scale_counts) & (track < limits.full_scale_counts - 1)
    valid[_frozen(sine, cosine, result, setting.config.frozen_samples)] = False
    error = (result.cycles - np.rint(truth[0] - result.phase[0])) + (result.phase - truth)
    # The count begins at zero, wherever the machine stands.
    start = np.rint(error[0])
    return valid, error - start, result.residual


def _frozen(
    sine: npt.NDArray[np.int64], cosine: npt.NDArray[np.int64], result: canfb.TrackResult, most: int
) -> npt.NDArray[np.intp]:
    """Where the check for a frozen input speaks: repeats in a row, in motion."""
    repeat = np.zeros(len(sine), dtype=np.bool_)
    repeat[1:] = (np.diff(sine) == 0) & (np.diff(cosine) == 0)
    places = np.arange(len(sine))
    run = places - np.maximum.accumulate(np.where(repeat, 0, places))  # repeats so far
    at = np.flatnonzero(run >= REPEATS)
    before = at - run[at]  # the last sample that was new: its speed counts
    earlier = np.maximum(before - 1, 0)
    speed = (result.cycles[before] - result.cycles[earlier]) + (result.phase[before] - result.phase[earlier])
    shift = np.abs(speed - np.rint(speed))
    frozen = (np.abs(speed) >= STANDSTILL_CYCLES) & ((shift > SHIFT_CYCLES) | (run[at] >= most))
    return at[frozen]
