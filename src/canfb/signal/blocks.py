"""Blocks of arrays that fit the processor's cache, and memory for their intermediate results."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

# 32768 samples x 8 bytes x eight arrays are 2 MiB, which fit a large second-level cache. A block takes about
# 60 calls of numpy: with a smaller cache, halving the block would cost more than cache misses.
BLOCK_SAMPLES = 32768
LINE_BYTES = 64  # a line of the cache, and a vector of AVX-512


def aligned(samples: int, kind: npt.DTypeLike) -> npt.NDArray[Any]:
    """An array of this length, not initialised, that begins at a line of the cache: twice as fast as one of
    numpy.
    """
    length = samples * np.dtype(kind).itemsize
    room = np.empty(length + LINE_BYTES, np.uint8)
    first = -room.ctypes.data % LINE_BYTES
    return room[first : first + length].view(kind)


class Scratch:
    """Arrays for intermediate results of a block, allocated once: fresh memory costs more than arithmetic."""

    __slots__ = ("_arrays", "a", "b", "bit", "bits", "cosine", "digits", "index", "raw", "sine")

    def __init__(self, arrays: Sequence[npt.NDArray[Any]]) -> None:
        self._arrays = arrays
        self.a, self.b, self.raw, self.sine, self.cosine, self.index, *digits = arrays
        self.digits = tuple(digits)
        self.bits = tuple(digit.view(np.bool_) for digit in digits)
        self.bit = self.bits[0]

    def head(self, samples: int) -> Scratch:
        return self if samples == len(self.a) else Scratch([one[:samples] for one in self._arrays])


def scratch_for(samples: int) -> Scratch:
    return Scratch([aligned(samples, kind) for kind in (*[np.float64] * 5, np.intp, *[np.int8] * 4)])


def blocks(samples: int) -> Iterator[tuple[slice, Scratch]]:
    scratch = scratch_for(min(samples, BLOCK_SAMPLES))
    for start in range(0, samples, BLOCK_SAMPLES):
        part = slice(start, min(start + BLOCK_SAMPLES, samples))
        yield part, scratch.head(part.stop - start)
