"""Arrays in blocks that stay in the processor's cache, and the memory to compute them in."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

# 16384 samples x 8 bytes x eight arrays are 1 MiB: in a usual second-level cache, and long enough that
# what numpy does once for each call is small against what it does for each sample.
BLOCK_SAMPLES = 16384


class Scratch:
    """Arrays for intermediate results, of the length of a block, any content.

    They are made once and used for block after block: to get fresh memory for every
    intermediate result takes longer than the arithmetic on it.
    """

    __slots__ = ("a", "b", "bit", "index", "octant", "samples")

    def __init__(self, samples: int) -> None:
        self.samples = samples
        self.a, self.b = np.empty(samples), np.empty(samples)
        self.index = np.empty(samples, np.intp)
        self.octant, self.bit = np.empty(samples, np.int8), np.empty(samples, np.bool_)

    def head(self, samples: int) -> Scratch:
        """A scratch of the first ``samples`` of these arrays, at most all of them."""
        part = Scratch.__new__(Scratch)
        part.samples = samples
        part.a, part.b, part.index = self.a[:samples], self.b[:samples], self.index[:samples]
        part.octant, part.bit = self.octant[:samples], self.bit[:samples]
        return part


def blocks(samples: int) -> Iterator[tuple[slice, Scratch]]:
    """Slices that cover 0..``samples`` one after the other, each with a scratch of its length."""
    scratch = Scratch(min(samples, BLOCK_SAMPLES))
    for start in range(0, samples, BLOCK_SAMPLES):
        length = min(BLOCK_SAMPLES, samples - start)
        if length < scratch.samples:
            scratch = Scratch(length)
        yield slice(start, start + length), scratch
