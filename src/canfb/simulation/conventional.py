"""The conventional method (paper, Fig. 1): a hardware counter of zero crossings beside the converters.

Both are never read at quite the same instant; a comparison of their quadrants corrects the count by one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canfb.signal.phase import FloatArray, raw_phases
from canfb.simulation.encoder import Encoder

IntArray = npt.NDArray[np.int64]


class ConventionalPosition(NamedTuple):
    """Cycle count, raw phase of the converted tracks, quadrants 0..3 of comparators and converters."""

    cycles: IntArray
    phase: FloatArray
    counter_quadrant: IntArray
    adc_quadrant: IntArray


def quadrant(sine: npt.ArrayLike, cosine: npt.ArrayLike) -> IntArray:
    """Quadrant 0..3 of the cycle from the signs of the tracks, as two comparators see it."""
    rising, right = np.asarray(sine) >= 0.0, np.asarray(cosine) >= 0.0
    return np.where(rising, np.where(right, 0, 1), np.where(right, 3, 2)).astype(np.int64)


def hardware_counter(encoder: Encoder, position_cycles: npt.ArrayLike) -> tuple[IntArray, IntArray]:
    """Cycle count and quadrant 0..3 that an ideal counter shows at these positions, below 1e12 cycles."""
    positions = np.asarray(position_cycles, dtype=np.float64)
    sine, cosine = encoder.tracks(positions)
    # The raw phase wraps where the counter counts, and is less than half a cycle off.
    return np.rint(positions - raw_phases(sine, cosine)).astype(np.int64), quadrant(sine, cosine)


def conventional_position(
    encoder: Encoder,
    position_cycles: npt.ArrayLike,
    counter_position_cycles: npt.ArrayLike,
    fix: bool = True,
    rng: np.random.Generator | None = None,
) -> ConventionalPosition:
    """Positions from a counter and two converters that are not read at the same instant, at two arrays of
    positions.

    ``fix`` corrects the count where the quadrants show it; two quadrants apart show no direction.
    """
    sampled = np.asarray(position_cycles, dtype=np.float64)
    counted = np.asarray(counter_position_cycles, dtype=np.float64)
    if sampled.shape != counted.shape:
        raise ValueError(f"both positions must be of one shape: {sampled.shape} and {counted.shape}")
    cycles, counter_quadrant = hardware_counter(encoder, counted)
    sine, cosine = encoder.sample(sampled, rng)
    adc_quadrant = quadrant(sine, cosine)
    if fix:
        cycles = cycles + ((counter_quadrant == 3) & (adc_quadrant == 0))
        cycles = cycles - ((counter_quadrant == 0) & (adc_quadrant == 3))
    phase = raw_phases(sine.astype(np.float64), cosine.astype(np.float64))
    return ConventionalPosition(cycles, phase, counter_quadrant, adc_quadrant)
