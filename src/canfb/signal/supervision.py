"""Checks of each sample before it may move the position: the limits of one sample, and a converter that
repeats its values while the machine moves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from canfb.objects import StatusBit
from canfb.signal.phase import AnyArray, BoolArray

# Plain integers for the hot path: an operation on an IntFlag costs ten times as much.
VALID: Final = int(StatusBit.VALID)
COASTING: Final = int(StatusBit.COASTING)
LOST: Final = int(StatusBit.LOST)
RESIDUAL: Final = int(StatusBit.RESIDUAL)
AMPLITUDE: Final = int(StatusBit.AMPLITUDE)
CLIPPED: Final = int(StatusBit.CLIPPED)
MISSED: Final = int(StatusBit.MISSED)
TABLE_ACTIVE: Final = int(StatusBit.TABLE_ACTIVE)
REFERENCED: Final = int(StatusBit.REFERENCED)
COARSE: Final = int(StatusBit.COARSE)
CALIBRATING: Final = int(StatusBit.CALIBRATING)
FROZEN: Final = int(StatusBit.FROZEN)
EXTRAPOLATED: Final = int(StatusBit.EXTRAPOLATED)
SECOND_POSITION: Final = int(StatusBit.SECOND_POSITION)

# After a fault the limits are narrower by this factor until a sample keeps them.
AMPLITUDE_HYSTERESIS = 1.0 / 32.0
CLIPPING_HYSTERESIS_COUNTS = 2
LEAST_LEFT = 0.25  # part of the amplitude that a low-pass leaves at four times its corner frequency


@dataclass(frozen=True)
class SampleLimits:
    """Limits that one sample must keep, all in ADC counts.

    A sample at either end of the converter, -full_scale or full_scale - 1, is clipped
    (2001:02). The amplitude after conditioning must lie in low..high (2001:03, 2001:04).
    """

    full_scale_counts: int
    amplitude_low_counts: float
    amplitude_high_counts: float

    def bounds(
        self, after_fault: bool = False, amplitude_known: bool = True
    ) -> tuple[float, float, float, float]:
        """The counts that are clipped at either end, smallest and largest good amplitude.

        ``after_fault``: with the hysteresis. ``amplitude_known`` False: the attenuation by the analog path is
        not known, so the smallest amplitude is lower.
        """
        full, low, high = self.full_scale_counts, self.amplitude_low_counts, self.amplitude_high_counts
        if not amplitude_known:
            low *= LEAST_LEFT
        if not after_fault:
            return -full, full - 1, low, high
        margin = min(CLIPPING_HYSTERESIS_COUNTS, full // 64)
        most = (high - low) / 4.0  # so that a narrow window stays open
        return (
            margin - full,
            full - 1 - margin,
            low + min(low * AMPLITUDE_HYSTERESIS, most),
            high - min(high * AMPLITUDE_HYSTERESIS, most),
        )


class Supervision:
    """Checks one sample after the other against :class:`SampleLimits`, with hysteresis."""

    __slots__ = ("_known", "_limits", "after_fault", "bounds")

    def __init__(self, limits: SampleLimits) -> None:
        self.set_limits(limits)

    def set_limits(self, limits: SampleLimits) -> None:
        self._limits, self.after_fault = limits, False
        self.amplitude_known(True)

    def amplitude_known(self, known: bool) -> None:
        """Set whether the speed, and so the attenuation by the analog path, is known."""
        self._known = known
        # The bounds in force, as plain values for the hot path.
        self.bounds = self._limits.bounds(self.after_fault, known)

    def faults(self, sine: float, cosine: float, amplitude: float) -> int:
        """Status bits AMPLITUDE and CLIPPED of a sample: raw counts, conditioned ``amplitude``.

        NaN is a fault of the amplitude.
        """
        lowest, highest, smallest, largest = self.bounds
        bits = 0
        if sine <= lowest or sine >= highest or cosine <= lowest or cosine >= highest:
            bits = CLIPPED
        if not smallest <= amplitude <= largest:
            bits |= AMPLITUDE
        if (bits != 0) is not self.after_fault:
            self.after_fault = bits != 0
            self.amplitude_known(self._known)
        return bits


def repeats(
    sine: AnyArray, cosine: AnyArray, before: tuple[float, float], out: BoolArray
) -> BoolArray | None:
    """True for each of 1 or more pairs that equals the pair before it, in ``out``; None: for none.

    ``before`` is the pair before the first one.
    """
    equal = out[: len(sine)]
    equal[0] = sine[0] == before[0]
    np.equal(sine[1:], sine[:-1], out=equal[1:])
    if not equal.any():  # the cosine cannot change that
        return None
    equal[0] &= cosine[0] == before[1]
    equal[1:] &= cosine[1:] == cosine[:-1]
    return equal if equal.any() else None


class FrozenInput:
    """Finds a frozen input by repeated pairs of counts.

    A machine slower than the residual limit may have stopped. A faster one cannot; but at whole cycles per
    sample all phases are equal, and only noise shows that the converter works. So ``frozen_samples``
    (2010:04) successive repeats are required; 0: off.
    """

    __slots__ = ("frozen_samples", "repeats", "residual_limit_cycles", "speed_cycles")

    def __init__(self, frozen_samples: int, residual_limit_cycles: float) -> None:
        self.frozen_samples = frozen_samples
        self.residual_limit_cycles = residual_limit_cycles
        self.repeats = 0
        self.speed_cycles = 0.0
        """Speed before the first repeat, cycles per interval."""

    def take(self, repeated: bool) -> bool:
        """Take a sample; ``repeated``: it equals the one before. True if the input is frozen."""
        if not repeated:
            self.repeats = 0
            return False
        self.repeats += 1
        return not self.stands and self.repeats >= self.frozen_samples

    @property
    def stands(self) -> bool:
        slow = not self.frozen_samples or abs(self.speed_cycles) < self.residual_limit_cycles
        return self.repeats > 0 and slow

    def before_row(self, equal: BoolArray) -> int:
        """Number of samples before the first row of repeats that is long enough, or not over yet.

        ``equal``: whether each sample equals the one before; the first one begins a row.
        """
        changes = np.flatnonzero(np.diff(equal, prepend=False, append=False))
        begins, ends = changes[::2], changes[1::2]
        rows = begins[(ends - begins >= self.frozen_samples) | (ends == len(equal))]
        return int(rows[0]) if len(rows) else len(equal)
