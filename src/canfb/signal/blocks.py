"""Arrays in blocks that stay in the processor's cache, and the memory to compute them in."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

# 32768 samples x 8 bytes x eight arrays are 2 MiB: in a large second-level cache. A block takes some 60 calls
# of numpy, and half as many samples for each of them cost more than a cache that is too small.
BLOCK_SAMPLES = 32768
LINE_BYTES = 64  # of the cache, and of a vector of AVX-512


def aligned(samples: int, kind: npt.DTypeLike) -> npt.NDArray[Any]:
    """An array of this length, any content, that begins at a line of the cache: twice as fast as numpy's
    own.
    """
    length = samples * np.dtype(kind).itemsize
    room = np.empty(length + LINE_BYTES, np.uint8)
    first = -room.ctypes.data % LINE_BYTES
    return room[first : first + length].view(kind)


class Scratch:
    """Arrays for intermediate results of a block, made once: fresh memory costs more than arithmetic."""

    __slots__ = ("a", "b", "bit", "bits", "cosine", "digits", "index", "raw", "samples", "sine")

    def __init__(self, samples: int) -> None:
        self.samples = samples
        self.a, self.b = aligned(samples, np.float64), aligned(samples, np.float64)
        self.raw, self.sine, self.cosine = (aligned(samples, np.float64) for _ in range(3))
        self.index = aligned(samples, np.intp)
        self.digits = tuple(aligned(samples, np.int8) for _ in range(4))
        self._view_bits()

    def _view_bits(self) -> None:
        self.bits = tuple(digit.view(np.bool_) for digit in self.digits)
        self.bit = self.bits[0]

    def head(self, samples: int) -> Scratch:
        if samples == self.samples:
            return self
        part = Scratch.__new__(Scratch)
        part.samples = samples
        part.a, part.b, part.index = self.a[:samples], self.b[:samples], self.index[:samples]
        part.raw, part.sine, part.cosine = self.raw[:samples], self.sine[:samples], self.cosine[:samples]
        part.digits = tuple(digit[:samples] for digit in self.digits)
        part._view_bits()
        return part


def blocks(samples: int) -> Iterator[tuple[slice, Scratch]]:
    scratch = Scratch(min(samples, BLOCK_SAMPLES))
    for start in range(0, samples, BLOCK_SAMPLES):
        length = min(BLOCK_SAMPLES, samples - start)
        if length < scratch.samples:
            scratch = Scratch(length)
        yield slice(start, start + length), scratch
