"""Checks of every sample before it may move the position; the bits of the status word 2011:01."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag
from typing import Final


class StatusBit(IntFlag):
    """Bits of the status word, object 2011:01."""

    VALID = 1 << 0
    COASTING = 1 << 1
    LOST = 1 << 2
    RESIDUAL = 1 << 3
    AMPLITUDE = 1 << 4
    CLIPPED = 1 << 5
    MISSED = 1 << 6
    TABLE_ACTIVE = 1 << 7
    REFERENCED = 1 << 8
    COARSE = 1 << 9
    CALIBRATING = 1 << 10


# Plain integers for the hot path: an operation on an IntFlag costs ten times as much.
VALID: Final = int(StatusBit.VALID)
COASTING: Final = int(StatusBit.COASTING)
LOST: Final = int(StatusBit.LOST)
RESIDUAL: Final = int(StatusBit.RESIDUAL)
AMPLITUDE: Final = int(StatusBit.AMPLITUDE)
CLIPPED: Final = int(StatusBit.CLIPPED)
MISSED: Final = int(StatusBit.MISSED)
TABLE_ACTIVE: Final = int(StatusBit.TABLE_ACTIVE)


@dataclass(frozen=True)
class SampleLimits:
    """Limits that one sample must keep, all in ADC counts.

    A sample at either end of the converter, -full_scale or full_scale - 1, is clipped
    (2001:02). The amplitude after conditioning must lie in low..high (2001:03, 2001:04).
    """

    full_scale_counts: int
    amplitude_low_counts: float
    amplitude_high_counts: float

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Between the first two are the counts of a good sample, from the third to the last its amplitude."""
        full = self.full_scale_counts
        return -full, full - 1, self.amplitude_low_counts, self.amplitude_high_counts

    def faults(self, sine: float, cosine: float, amplitude: float) -> int:
        """Status bits AMPLITUDE and CLIPPED of a sample: raw counts, conditioned amplitude.

        A value that is not a number is a fault of the amplitude.
        """
        lowest, highest, smallest, largest = self.bounds
        bits = 0
        if not (lowest < sine < highest and lowest < cosine < highest):
            bits = CLIPPED
        if not smallest <= amplitude <= largest:
            bits |= AMPLITUDE
        return bits
