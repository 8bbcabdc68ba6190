"""Conditioning of the tracks before Table 1: offset, gain, phase error and delays (2002:01..07)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from canfb.checks import within
from canfb.signal.blocks import Scratch
from canfb.signal.phase import AnyArray, FloatArray

Coefficients = tuple[float, float, float, float, float]
HARMONIC_ORDERS = (-1, 2, -2, 3, -3, 5, -5)  # of cosine + i sine
LARGEST_HARMONIC = 0.5
LONGEST_DELAY_S = 0.01  # of 2002:06 and 2002:07, either sign


@dataclass(frozen=True)
class Conditioning:
    """Turns an offset, skewed ellipse into a circle. The identity (default) is the paper's method.

    The model is sine = sine_offset + A/sine_gain sin(x), cosine = cosine_offset +
    A/cosine_gain cos(x - phase_error), with x the angle in the cycle. Raises ValueError for a
    value out of range, or one that is not finite.

    sine_offset_counts     zero of the sine track (2002:01), any finite value
    cosine_offset_counts   zero of the cosine track (2002:02), any finite value
    sine_gain              factor of the sine track (2002:03), 0.001..1000 or its negative
    cosine_gain            factor of the cosine track (2002:04), 0.001..1000 or its negative
    phase_error_rad        deviation of the tracks from a right angle (2002:05), within -pi/3..pi/3
    cosine_delay_s         delay of the cosine sample after the sine (2002:06), -0.01..0.01 s
    delay_s                common delay of the analog path and the converter (2002:07), -0.01..0.01 s

    harmonic_1_backward_real       real part of order -1 (2005:01), -0.5..0.5
    harmonic_1_backward_imaginary  imaginary part of order -1 (2005:02), -0.5..0.5
    harmonic_2_forward_real        real part of order 2 (2005:03), -0.5..0.5
    harmonic_2_forward_imaginary   imaginary part of order 2 (2005:04), -0.5..0.5
    harmonic_2_backward_real       real part of order -2 (2005:05), -0.5..0.5
    harmonic_2_backward_imaginary  imaginary part of order -2 (2005:06), -0.5..0.5
    harmonic_3_forward_real        real part of order 3 (2005:07), -0.5..0.5
    harmonic_3_forward_imaginary   imaginary part of order 3 (2005:08), -0.5..0.5
    harmonic_3_backward_real       real part of order -3 (2005:09), -0.5..0.5
    harmonic_3_backward_imaginary  imaginary part of order -3 (2005:0A), -0.5..0.5
    harmonic_5_forward_real        real part of order 5 (2005:0B), -0.5..0.5
    harmonic_5_forward_imaginary   imaginary part of order 5 (2005:0C), -0.5..0.5
    harmonic_5_backward_real       real part of order -5 (2005:0D), -0.5..0.5
    harmonic_5_backward_imaginary  imaginary part of order -5 (2005:0E), -0.5..0.5

    The harmonics are those of conditioned cosine + i sine at standstill, relative to the fundamental. They
    are used only with a low-pass or a cosine delay: :mod:`canfb.signal.front_end`.

    :meth:`apply` holds at standstill, :mod:`canfb.signal.front_end` at speed. ``delay_s`` does not change the
    tracks: the published position is extrapolated by it.
    """

    sine_offset_counts: float = 0.0
    cosine_offset_counts: float = 0.0
    sine_gain: float = 1.0
    cosine_gain: float = 1.0
    phase_error_rad: float = 0.0
    cosine_delay_s: float = 0.0
    delay_s: float = 0.0
    harmonic_1_backward_real: float = 0.0
    harmonic_1_backward_imaginary: float = 0.0
    harmonic_2_forward_real: float = 0.0
    harmonic_2_forward_imaginary: float = 0.0
    harmonic_2_backward_real: float = 0.0
    harmonic_2_backward_imaginary: float = 0.0
    harmonic_3_forward_real: float = 0.0
    harmonic_3_forward_imaginary: float = 0.0
    harmonic_3_backward_real: float = 0.0
    harmonic_3_backward_imaginary: float = 0.0
    harmonic_5_forward_real: float = 0.0
    harmonic_5_forward_imaginary: float = 0.0
    harmonic_5_backward_real: float = 0.0
    harmonic_5_backward_imaginary: float = 0.0

    def __post_init__(self) -> None:
        within(self, **dict.fromkeys(self.words, float))
        for name in ("sine_gain", "cosine_gain"):
            if not 1e-3 <= abs(getattr(self, name)) <= 1e3:
                raise ValueError(f"{name} is out of range: its size must be 0.001 to 1000")
        if abs(self.phase_error_rad) >= math.pi / 3:
            raise ValueError("phase_error_rad is out of range: its size must be below pi/3")
        for name in ("cosine_delay_s", "delay_s"):
            if abs(getattr(self, name)) > LONGEST_DELAY_S:
                raise ValueError(f"{name} is out of range: its size must be at most {LONGEST_DELAY_S} s")
        for name, value in self.words.items():
            if name.startswith("harmonic") and abs(value) > LARGEST_HARMONIC:
                raise ValueError(f"{name} is out of range: its size must be at most {LARGEST_HARMONIC}")

    @property
    def words(self) -> dict[str, float]:
        """The fields by name, in the order of 2002:01..07, 2005:01..0E."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def values(self) -> tuple[float, ...]:
        """The fields in the order of 2002:01..07, 2005:01..0E."""
        return tuple(self.words.values())

    @property
    def harmonics(self) -> tuple[complex, ...]:
        """Harmonics of :data:`HARMONIC_ORDERS`, relative to the fundamental."""
        parts = self.values[-2 * len(HARMONIC_ORDERS) :]
        return tuple(complex(*parts[n : n + 2]) for n in range(0, len(parts), 2))

    def with_harmonics(self, harmonics: Sequence[complex]) -> Conditioning:
        """The same with these ``harmonics``."""
        parts = [part for one in harmonics for part in (float(one.real), float(one.imag))]
        return Conditioning(*self.values[: -len(parts)], *parts)

    @property
    def is_identity(self) -> bool:
        """True if it changes nothing."""
        return self == IDENTITY

    def coefficients(self) -> Coefficients:
        """(sine offset, sine gain, cosine offset, cosine factor, skew): s = (sine - offset) gain, c =
        (cosine - offset) factor - s skew, factor = gain / cos(phase error), skew = tan(phase error).
        """
        return (
            float(self.sine_offset_counts),
            float(self.sine_gain),
            float(self.cosine_offset_counts),
            float(self.cosine_gain) / math.cos(self.phase_error_rad),
            math.tan(self.phase_error_rad),
        )

    def with_delays_of(self, other: Conditioning) -> Conditioning:
        """The same with the delays of ``other``."""
        return replace(self, cosine_delay_s=other.cosine_delay_s, delay_s=other.delay_s)

    def apply(self, sine: Any, cosine: Any) -> tuple[Any, Any]:
        """Conditioned tracks in counts, scalars or float64 arrays; both give the same bits."""
        offset_s, gain_s, offset_c, factor_c, skew = self.coefficients()
        s = (sine - offset_s) * gain_s
        return s, (cosine - offset_c) * factor_c - s * skew

    def apply_block(
        self, sine: AnyArray, cosine: AnyArray, scratch: Scratch
    ) -> tuple[FloatArray, FloatArray]:
        """:meth:`apply` for a block, into ``scratch.sine`` and ``scratch.cosine``."""
        offset_s, gain_s, offset_c, factor_c, skew = self.coefficients()
        s, c = scratch.sine, scratch.cosine
        np.subtract(sine, offset_s, out=s, dtype=np.float64)
        s *= gain_s
        np.subtract(cosine, offset_c, out=c, dtype=np.float64)
        c *= factor_c
        c -= np.multiply(s, skew, out=scratch.a)
        return s, c


IDENTITY = Conditioning()
