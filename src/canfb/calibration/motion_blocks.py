"""Short blocks of samples, in each of which the motion is a low polynomial of time."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from canfb.signal.phase import FloatArray

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
    """

    index: IntArray
    used: BoolArray
    terms: FloatArray

    def __len__(self) -> int:
        return len(self.index)

    def take(self, rows: IntArray | BoolArray) -> Blocks:
        """These blocks only."""
        return Blocks(self.index[rows], self.used[rows], self.terms[rows])

    def using(self, used: BoolArray) -> Blocks:
        """The same blocks with other samples left out; blocks with too few samples give none."""
        enough = used.sum(axis=1) >= self.coefficients + SPARE
        return replace(self, used=used & enough[:, None])

    @property
    def coefficients(self) -> int:
        """Coefficients of the polynomial of a block."""
        return int(self.terms.shape[2])

    @property
    def samples(self) -> int:
        """Samples used."""
        return int(self.used.sum())

    @property
    def freedom(self) -> int:
        """Samples used less the polynomials' coefficients."""
        return self.samples - self.coefficients * int(self.used.any(axis=1).sum())

    @property
    def correct(self) -> float:
        """Rms of deviations from the polynomials: times this for that of the samples themselves."""
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
        """Coefficients of the polynomials of least squares through values (blocks, length)."""
        weighted = np.where(self.used[..., None], self.terms, 0.0)
        right = np.einsum("blt,bl->bt", weighted, np.where(self.used, values, 0.0))
        return solve_blocks(np.matmul(weighted.transpose(0, 2, 1), weighted), right[..., None])[..., 0]

    def evaluate(self, coefficients: FloatArray) -> FloatArray:
        """Polynomials at every sample, shape (blocks, length)."""
        return np.asarray(np.matmul(self.terms, coefficients[..., None])[..., 0], np.float64)


def solve_blocks(matrices: FloatArray, right: FloatArray) -> FloatArray:
    """Solutions of many small positive systems; a block without samples gives zero."""
    size = np.trace(matrices, axis1=1, axis2=2)
    # The small ridge only matters where samples are too few or too close together.
    ridge = np.where(size > 0.0, size * 1e-13, 1.0)
    return np.asarray(
        np.linalg.solve(matrices + ridge[:, None, None] * np.eye(matrices.shape[1]), right), np.float64
    )


def cut(time: FloatArray, valid: BoolArray, breaks: IntArray, length: int, terms: int = CUBIC) -> Blocks:
    """Cut samples into blocks of about ``length``; none reaches across a break.

    In each block the motion is a polynomial of ``terms`` coefficients.
    ``time`` in any unit, rising; ``breaks`` are the first samples of the segments after the first.
    """
    edges = [0, *(int(b) for b in breaks), len(time)]
    starts: list[int] = []
    stops: list[int] = []
    for first, last in itertools.pairwise(edges):
        if last - first < terms + SPARE:
            continue
        count = max(1, round((last - first) / length))
        at = np.linspace(first, last, count + 1).round().astype(np.int64).tolist()
        starts += at[:-1]
        stops += at[1:]
    start, stop = np.array(starts, np.int64), np.array(stops, np.int64)
    if not len(start):
        return Blocks(np.zeros((0, 1), np.int64), np.zeros((0, 1), np.bool_), np.zeros((0, 1, terms)))
    place = start[:, None] + np.arange(int((stop - start).max()))
    inside = place < stop[:, None]
    index = np.minimum(place, stop[:, None] - 1)
    begin, end = time[start][:, None], time[stop - 1][:, None]
    x = 2.0 * (time[index] - begin) / (end - begin) - 1.0
    legendre = np.asarray(np.polynomial.legendre.legvander(x, terms - 1), np.float64)
    used = inside & valid[index]
    blocks = Blocks(index, inside, legendre).using(used)
    return blocks.take(np.flatnonzero(blocks.used.any(axis=1)))
