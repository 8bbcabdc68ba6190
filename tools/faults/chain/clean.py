"""Clean samples of the fault campaign: how many are flagged although nothing is wrong.

Over arrays, by :func:`canfb.signal.stream.process_stream`: the same bits as the chain, sample by sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from canfb.signal.stream import process_stream
from tools.faults.chain.judge import HARM_CYCLES
from tools.faults.chain.plant import (
    ENCODER,
    SETTINGS,
    TOP_CYCLES,
    Counts,
    FloatArray,
    Setting,
)

CHUNK_SAMPLES = 1_000_000
REST = 10  # samples at standstill before the first move of a servo
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


def run_clean(seed: int, chunk: int, samples: int, settings: Sequence[Setting] = SETTINGS) -> CleanResult:
    """One chunk, from standstill on; the ``settings`` take turns."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, chunk, 1 << 20]))
    setting = settings[chunk % len(settings)]
    truth = clean_motion(setting, samples, rng)
    sine, cosine = ENCODER.sample(truth, rng)
    valid, error, residual = judge_clean(setting, sine, cosine, truth)
    return CleanResult(
        samples,
        int(np.count_nonzero(~valid)),
        int(np.count_nonzero(np.abs(error) > HARM_CYCLES)),
        float(residual.max()),
        float(np.abs(np.diff(truth)).max(initial=0.0)),
    )


def clean_motion(setting: Setting, samples: int, rng: np.random.Generator) -> FloatArray:
    """Positions from standstill: ramps and constant speeds up to the top speed, with a ripple on them."""
    acceleration, accelerations = setting.acceleration, np.zeros(samples)
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
    positions: FloatArray = float(rng.uniform()) + np.cumsum(np.cumsum(accelerations)) + ripple
    return positions


def judge_clean(
    setting: Setting, sine: Counts, cosine: Counts, truth: FloatArray
) -> tuple[npt.NDArray[np.bool_], FloatArray, FloatArray]:
    """VALID of every sample, the error of its position, and its residual, both in cycles."""
    (result,) = process_stream([(sine, cosine)], setting.config, setting.table)
    error = result.cycles + (result.phase - truth)
    # The count begins at zero, wherever the machine stands.
    return result.valid, error - np.rint(error[0]), result.residual
