"""Short blocks of samples, in each of which the motion is a low polynomial of time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canfb.signal.phase import FloatArray, wrap

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

CUBIC = 4
SPARE = 2  # a block with fewer samples than coefficients and these says nothing about the tracks


@dataclass(frozen=True, eq=False)
class Blocks:
    """Samples in rows, one row a block.

    index   sample numbers, shape (blocks, length), filled up where a block is shorter
    used    False for filling and for samples left out
    terms   Legendre polynomials of time -1..1 over the block, shape (blocks, length, coefficients)
    tracks  counts, shape (2, blocks, length), sine first
    """

    index: IntArray
    used: BoolArray
    terms: FloatArray
    tracks: FloatArray

    def __len__(self) -> int:
        return len(self.index)

    def take(self, rows: IntArray | BoolArray) -> Blocks:
        return Blocks(self.index[rows], self.used[rows], self.terms[rows], self.tracks[:, rows])

    def using(self, used: BoolArray) -> Blocks:
        """The same blocks with other samples left out; blocks with too few samples give none."""
        enough = used.sum(axis=1) >= self.coefficients + SPARE
        return replace(self, used=used & enough[:, None])

    @property
    def coefficients(self) -> int:
        return int(self.terms.shape[2])

    @property
    def samples(self) -> int:
        return int(self.used.sum())

    @property
    def freedom(self) -> int:
        return self.samples - self.coefficients * int(self.used.any(axis=1).sum())

    @property
    def correct(self) -> float:
        return float(np.sqrt(self.samples / max(1, self.freedom)))

    def informative(self, position: FloatArray) -> BoolArray:
        """Blocks whose samples meet at least four eighths of the cycle.

        ``position`` in cycles, (blocks, length). At standstill, or locked to the samples,
        any table looks good.
        """
        eighth = (position % 1.0 * 8.0).astype(np.int64) % 8
        met = np.zeros((len(self), 8), np.bool_)
        rows = np.broadcast_to(np.arange(len(self))[:, None], eighth.shape)
        met[rows[self.used], eighth[self.used]] = True
        return np.asarray(met.sum(axis=1) >= 4, np.bool_)

    def smooth(self, values: FloatArray) -> FloatArray:
        weighted = np.where(self.used[..., None], self.terms, 0.0)
        right = np.einsum("blt,bl->bt", weighted, np.where(self.used, values, 0.0))
        return solve_blocks(np.matmul(weighted.transpose(0, 2, 1), weighted), right[..., None])[..., 0]

    def evaluate(self, coefficients: FloatArray) -> FloatArray:
        return np.asarray(np.matmul(self.terms, coefficients[..., None])[..., 0], np.float64)


def solve_blocks(matrices: FloatArray, right: FloatArray) -> FloatArray:
    """Solutions of many small positive systems; a block without samples gives zero."""
    size = np.trace(matrices, axis1=1, axis2=2)
    # The small ridge only matters where samples are too few or too close together.
    ridge = np.where(size > 0.0, size * 1e-13, 1.0)
    return np.asarray(
        np.linalg.solve(matrices + ridge[:, None, None] * np.eye(matrices.shape[1]), right), np.float64
    )


BINS = 64  # of the cycle
MIN_PER_BIN = 2


def bins_of(phase: FloatArray) -> npt.NDArray[np.int64]:
    return (phase % 1.0 * BINS).astype(np.int64) % BINS


def samples_in_bins(phase: FloatArray) -> npt.NDArray[np.int64]:
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
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def robust_rms(values: FloatArray) -> float:
    """Standard deviation, by the median."""
    return 1.4826 * float(np.median(np.abs(values))) if len(values) else 0.0


def runs(marked: BoolArray) -> IntArray:
    """First and end of runs of True, shape (n, 2)."""
    return np.flatnonzero(np.diff(marked, prepend=False, append=False)).reshape(-1, 2)


def peak(values: FloatArray) -> float:
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
    middle = (np.arange(BINS) + 0.5) / BINS
    return ErrorCurve(middle, mean_in_bins(position, before), mean_in_bins(position, after))
