"""Motion that is locked to the samples: each q-th sample lies at the same phase."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from canfb.signal.phase import FloatArray

WINDOW = 256  # samples; a reference measurement needs that the phases move within about this many
LARGEST_DENOMINATOR = 16
DRIFT_CYCLES = 0.36  # over the window, times the denominator: less is too close to locked
# Steps in cycles per sample, far from simple fractions; the first that leads away from them is taken.
STEPS = (0.382, 0.276, 0.171, 0.236, 0.118, 0.073, 0.045)
FAR = 0.03


class Lock(NamedTuple):
    """So many cycles per sample: numerator / denominator, and an unknown whole number."""

    numerator: int
    denominator: int


def find_lock(sine: FloatArray, cosine: FloatArray) -> Lock | None:
    """The lock of these tracks (ADC counts, NaN for a missed sample); None without one, or below 256 samples.

    Locked at p/q, each q-th sample lies at the same place; here for q up to 16, on windows of 256.
    """
    z = cosine + 1j * sine
    windows = len(z) // WINDOW
    if not windows:
        return None
    rows = z[: windows * WINDOW].reshape(windows, WINDOW)
    power = np.nanmean(np.abs(rows) ** 2)
    for q in range(1, LARGEST_DENOMINATOR + 1):
        length = WINDOW // q * q
        places = rows[:, :length].reshape(windows, length // q, q)
        seen = ~np.isnan(places)
        mean = np.where(seen, places, 0.0).sum(axis=1) / np.maximum(1, seen.sum(axis=1))
        if np.mean(np.abs(mean) ** 2) > power * np.sinc(DRIFT_CYCLES / q) ** 2:
            turn = z[1:] * np.conj(z[:-1])
            step = float(np.angle(np.nansum(turn))) / (2.0 * math.pi)
            return Lock(round(step * q) % q, q)
    return None


def away_from(fraction: float) -> float:
    """What to add to these cycles per sample so that they are no simple fraction."""
    for step in STEPS:
        multiples = [q * (fraction + step) for q in range(1, LARGEST_DENOMINATOR + 1)]
        if all(abs(one - round(one)) >= FAR for one in multiples):
            return step
    return STEPS[0]
