"""A recording of both tracks in bounded memory, in the format of 2050h of module and interface: INTEGER16,
little-endian.
"""

from __future__ import annotations

import sys
from array import array

from canfb.objects import MISSED_COUNTS

CAPACITY_SAMPLES = 1_000_000
BYTES_PER_SAMPLE = 4


class SampleRecording:
    """Pairs of ADC counts, up to ``capacity`` samples; a missing one keeps its place."""

    __slots__ = ("_counts", "capacity")

    def __init__(self, capacity: int = CAPACITY_SAMPLES) -> None:
        """An empty recording for 1 or more samples. ValueError for another ``capacity``."""
        if capacity < 1:
            raise ValueError(f"capacity is {capacity}; give the number of samples, 1 or more")
        self.capacity = capacity
        self._counts = array("h")

    def __len__(self) -> int:
        return len(self._counts) // 2

    @property
    def is_full(self) -> bool:
        return len(self) >= self.capacity

    def clear(self) -> None:
        self._counts = array("h")

    def take(self, sine: int, cosine: int) -> None:
        """Add one sample, INTEGER16 counts; no effect when the recording is full."""
        counts = self._counts
        if len(counts) < 2 * self.capacity:
            counts.extend((sine, cosine))

    def miss(self) -> None:
        self.take(MISSED_COUNTS, MISSED_COUNTS)

    def to_bytes(self) -> bytes:
        """All samples so far, sine before cosine, INTEGER16, little-endian."""
        if sys.byteorder == "little":
            return self._counts.tobytes()
        swapped = self._counts[:]
        swapped.byteswap()
        return swapped.tobytes()
