"""Figures over the cycle: coverage, errors about their mean, rms, peak, in bins of the phase, harmonics.

Phases have no first and no last: a mean is the angle of the mean of unit vectors. Where a mean, an rms or a
coverage over the phase is given, the cycle has 64 bins.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canfb.signal.phase import FloatArray, wrap

BINS = 64  # of the cycle
MIN_PER_BIN = 2


def bins_of(phase: FloatArray) -> npt.NDArray[np.int64]:
    """The bin, 0..63, of each phase (cycles, any whole number of them more)."""
    return (phase % 1.0 * BINS).astype(np.int64) % BINS


def samples_in_bins(phase: FloatArray) -> npt.NDArray[np.int64]:
    """How many of these phases are in each bin."""
    return np.bincount(bins_of(phase), minlength=BINS)


def mean_in_bins(phase: FloatArray, values: FloatArray) -> FloatArray:
    """Mean of the values at these phases in each bin, NaN in one without."""
    count = samples_in_bins(phase)
    with np.errstate(invalid="ignore"):
        mean = np.bincount(bins_of(phase), values, BINS) / np.where(count, count, np.nan)
    return np.asarray(mean, np.float64)


def coverage(phase: FloatArray) -> float:
    """Part of the cycle that is sampled: bins of 1/64 with two of these phases (cycles) in or beside them."""
    return covered(samples_in_bins(phase))


def covered(counts: Sequence[int] | npt.NDArray[np.int64]) -> float:
    """:func:`coverage` for this many samples in each of the bins."""
    here = np.asarray(counts)
    return float(np.mean(np.roll(here, 1) + here + np.roll(here, -1) >= MIN_PER_BIN))


def about_mean(
    off: FloatArray, of: FloatArray | None = None, weights: FloatArray | None = None
) -> FloatArray:
    """Differences of phases (cycles) within half a cycle about their mean, or that of other ones, ``of``.

    The mean is the angle of the mean of the unit vectors, weighted by ``weights`` if given.
    """
    vectors = np.exp(2j * np.pi * (off if of is None else of))
    middle = np.angle(np.average(vectors, weights=weights)) / (2.0 * np.pi)
    return wrap(off - middle)


def root_mean(values: FloatArray) -> float:
    """Root mean square, 0 of nothing."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def peak(values: FloatArray) -> float:
    """Largest size, 0 of nothing."""
    return float(np.abs(values).max()) if len(values) else 0.0


class ErrorHarmonic(NamedTuple):
    """One harmonic of the error: amplitude cos(2 pi order phase + angle), amplitude in cycles."""

    order: int
    amplitude_cycles: float
    angle_rad: float


@dataclass(frozen=True, eq=False)
class ErrorCurve:
    """Mean deviation from smooth motion over the phase, in cycles, on data not used for the fit.

    phase    middle of each bin, cycles
    before   identity table, its mean removed
    after    correction table
    NaN in a bin without samples.
    """

    phase: FloatArray
    before: FloatArray
    after: FloatArray


def error_curve(position: FloatArray, before: FloatArray, after: FloatArray) -> ErrorCurve:
    """Mean of both deviations in bins of the phase."""
    middle = (np.arange(BINS) + 0.5) / BINS
    return ErrorCurve(middle, mean_in_bins(position, before), mean_in_bins(position, after))


def error_harmonics(
    phase: FloatArray, angle: FloatArray, smallest_cycles: float, highest: int = 64
) -> tuple[ErrorHarmonic, ...]:
    """Harmonics of ``angle - phase`` at equidistant ``phase`` (cycles), those above ``smallest_cycles``."""
    spectrum = np.fft.rfft(angle - phase) / len(phase)
    found = [
        ErrorHarmonic(order, 2.0 * float(abs(spectrum[order])), float(np.angle(spectrum[order])))
        for order in range(1, min(highest, len(spectrum) - 1) + 1)
    ]
    return tuple(
        sorted(
            (h for h in found if h.amplitude_cycles > smallest_cycles),
            key=lambda h: -h.amplitude_cycles,
        )
    )
