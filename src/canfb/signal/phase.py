"""Phase within the cycle by division (Hoescheler and Szamel 1997, Table 1).

The raw phase of ideal tracks is off by up to 1.132 % of a cycle, which the correction table removes. The last
column of the printed table must be 1 + s/(8c): as printed, the curve would jump at 7/8.

Errors about arrays of tracks say what the caller passed instead.
"""

from __future__ import annotations

import math
from typing import Any, overload

import numpy as np
import numpy.typing as npt

from canfb.signal.blocks import Scratch, blocks

ArrayLike = npt.ArrayLike
FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
ComplexArray = npt.NDArray[np.complex128]
AnyArray = npt.NDArray[Any]

SCALARS = (int, float, np.floating, np.integer, np.bool_)


@overload
def phase_in_cycle(sine: float, cosine: float) -> float: ...
@overload
def phase_in_cycle(sine: ArrayLike, cosine: ArrayLike) -> FloatArray: ...
def phase_in_cycle(sine: Any, cosine: Any) -> Any:
    """Raw phase of one sample, or of arrays, in cycles: 0 <= raw phase < 1 (Table 1); 0 at the positive
    zero crossing of the sine.

    ``sine`` and ``cosine`` have any common unit and any size; arrays are broadcast. NaN where there is no
    phase: both tracks zero, or not a number. A float for scalars, an ndarray of float64 for arrays, with
    the same bits. ValueError for complex numbers.
    """
    if isinstance(sine, SCALARS) and isinstance(cosine, SCALARS):
        return raw_phase(float(sine), float(cosine))
    s, c = np.broadcast_arrays(real_array("sine", sine), real_array("cosine", cosine))
    return raw_phases(s, c)


def real_array(name: str, values: ArrayLike) -> FloatArray:
    """``values`` as an array of float64; ValueError, with this name, for complex or too large numbers."""
    if np.iscomplexobj(values):
        raise ValueError(f"{name} must be real numbers, not complex ones")
    try:
        return np.asarray(_with_gaps(values), dtype=np.float64)
    except OverflowError:
        raise ValueError(f"{name} must be less than 1.8e308") from None


def _with_gaps(values: ArrayLike) -> ArrayLike:
    # NaN for the masked elements of an array.
    return np.ma.asarray(values, float).filled(np.nan) if np.ma.is_masked(values) else values


def wrap(cycles: FloatArray) -> FloatArray:
    """Differences of phases, taken to -0.5..0.5 cycle by whole cycles."""
    return np.asarray((cycles + 0.5) % 1.0 - 0.5, np.float64)


def raw_phase(s: float, c: float) -> float:
    """Table 1 for one sample; NaN when both tracks are zero, or one is not a number."""
    if c > 0.0 and -c <= s <= c:
        phase = 0.125 * (s / c)
        if phase < 0.0:
            phase += 1.0
        # A tiny negative sine rounds up to 1.0, which is phase 0; adding 0.0 turns -0.0 into 0.0.
        return phase + 0.0 if phase != 1.0 else 0.0
    if c < 0.0 and c <= s <= -c:
        return 0.5 + 0.125 * (s / c)
    if s > 0.0:
        return 0.25 - 0.125 * (c / s)
    return 0.75 - 0.125 * (c / s) if s < 0.0 else math.nan


def raw_phases(s: FloatArray, c: FloatArray) -> FloatArray:
    """Table 1 for arrays of one shape: the same operations as :func:`raw_phase`, hence the same bits."""
    phases = np.empty(s.shape)
    flat_s, flat_c, flat = s.reshape(-1), c.reshape(-1), phases.reshape(-1)
    for part, scratch in blocks(len(flat)):
        raw_phase_block(flat_s[part], flat_c[part], flat[part], scratch)
        wrap_block(flat[part], scratch)
    return phases


def raw_phase_block(s: AnyArray, c: AnyArray, out: FloatArray, scratch: Scratch) -> None:
    """Table 1 for one block of integers or floats, into ``out``: raw phases 0..1, where 1.0 means 0.0.

    In eighths of a cycle the raw phase is |base - ratio|; the division by 8, a power of two, is exact.
    """
    larger = scratch.b
    size_s, size_c = _sizes(s, c, scratch)
    np.greater(size_s, size_c, out=scratch.bit)
    np.minimum(size_s, size_c, out=out)
    np.maximum(size_s, size_c, out=larger)
    with np.errstate(invalid="ignore"):
        out /= larger
    np.subtract(_bases(s, c, scratch), out, out=out)
    np.abs(out, out=out)
    out *= 0.125


def _sizes(s: AnyArray, c: AnyArray, scratch: Scratch) -> tuple[AnyArray, ...]:
    if s.dtype == c.dtype == np.int16:
        rows = scratch.a.view(np.int16).reshape(4, -1)
        # |-32768| overflows int16, but its bits are right as uint16.
        return np.abs(s, out=rows[0]).view(np.uint16), np.abs(c, out=rows[1]).view(np.uint16)
    return np.abs(s, out=scratch.a, dtype=np.float64), np.abs(c, out=scratch.b, dtype=np.float64)


def _bases(s: AnyArray, c: AnyArray, scratch: Scratch) -> npt.NDArray[np.int8]:
    """Bases of the octants; ``scratch.bit`` is set where the sine is the larger track.

    cosine < 0, sine < 0, sine larger   000  001  010  011  100  101  110  111
    base, eighths of a cycle              0    2    8   -6    4   -2   -4    6

    With n = sine < 0, l = sine larger, m = l xor cosine < 0: 8 (n - 2 n m) + 4 m - 2 l. Selecting by
    conditions would be slow.
    """
    sine_larger, mixed, negative, both = scratch.bits
    sine_larger_1, mixed_1, base, both_1 = scratch.digits
    np.less(c, 0, out=mixed)
    np.logical_xor(mixed, sine_larger, out=mixed)
    np.less(s, 0, out=negative)
    np.logical_and(negative, mixed, out=both)
    base -= both_1
    base -= both_1
    base += base
    base += mixed_1
    base += base
    base -= sine_larger_1
    base += base
    return base


def wrap_block(phases: FloatArray, scratch: Scratch) -> None:
    """Take phases of -1 <= phase < 2 into 0..1, in place; 1.0 only for a tiny negative one."""
    phases -= np.floor(phases, out=scratch.a)


FEW_SAMPLES = 64  # fewer are too few to check mid-scale and full scale
LEAST_NORMALISED = 0.05  # peak of tracks in -1..1; a lower one may be noise of dead inputs
LEAST_SPREAD = 0.25  # range of counts around a centre that is not zero, relative to the largest


def pair_of_tracks(
    sine: ArrayLike, cosine: ArrayLike, *, may_be_offset: bool = False
) -> tuple[AnyArray, AnyArray]:
    """Both tracks as arrays of one shape (n,), ADC counts with zero at mid-scale; else ValueError.

    ``may_be_offset``: a conditioning removes the offset, so unsigned counts are accepted.
    """
    kinds = "iuf" if may_be_offset else "if"
    sines, cosines = _numbers("sine", sine, kinds), _numbers("cosine", cosine, kinds)
    if sines.ndim != 1 or sines.shape != cosines.shape:
        raise ValueError(
            "sine and cosine must be arrays of one dimension and of one length, "
            f"not of shape {sines.shape} and {cosines.shape}"
        )
    return sines, cosines


def check_counts(sine: AnyArray, cosine: AnyArray, *, may_be_offset: bool = False) -> None:
    """ValueError for tracks that cannot be counts with zero at mid-scale.

    They are in -1..1, or turn round a circle but never go below zero. Fewer than 64 samples pass.
    """
    if len(sine) >= FEW_SAMPLES:
        _refuse_normalised(sine, cosine)
        if not may_be_offset and goes_round_off_zero(sine, cosine):
            raise ValueError(
                "sine and cosine must be zero at mid-scale, but no count is below zero: subtract mid-scale, "
                "2048 with 12 bits"
            )


def _numbers(name: str, track: ArrayLike, kinds: str) -> AnyArray:
    try:
        numbers = np.asarray(_with_gaps(track))
    except ValueError:
        raise ValueError(f"{name} must be an array of one dimension: its rows differ in length") from None
    if numbers.dtype.kind in kinds:
        return numbers
    if numbers.dtype.kind == "u":
        raise ValueError(
            f"{name} must be signed counts, zero at mid-scale, not {numbers.dtype}: subtract mid-scale, "
            f"{name}.astype(int) - 2048 with 12 bits"
        )
    if numbers.dtype.kind == "O":
        try:
            return numbers.astype(np.float64)
        except (TypeError, ValueError, OverflowError):
            pass
    raise ValueError(f"{name} must be real numbers (ADC counts), not {numbers.dtype}")


def _refuse_normalised(sine: AnyArray, cosine: AnyArray) -> None:
    if sine.dtype.kind == "i" or not (_is_small(sine[:FEW_SAMPLES]) and _is_small(cosine[:FEW_SAMPLES])):
        return  # nearly always
    peak = max(np.nanmax(np.abs(track), initial=0.0) for track in (sine, cosine))
    if LEAST_NORMALISED < peak <= 1.0:
        raise ValueError(
            f"sine and cosine must be ADC counts, but none exceeds {peak:.3g}: multiply tracks in -1..1 "
            "by the full scale, 2048 with 12 bits"
        )


def _is_small(track: AnyArray) -> bool:
    return not (np.abs(track) > 1.0).any()


def goes_round_off_zero(sine: AnyArray, cosine: AnyArray) -> bool:
    """True if no count is negative although the tracks turn round a circle; at standstill none may be."""
    if len(sine) < FEW_SAMPLES or (sine[:FEW_SAMPLES] < 0).any() or (cosine[:FEW_SAMPLES] < 0).any():
        return False  # nearly always
    sides = []
    for track in (sine, cosine):
        low, high = float(track.min()), float(track.max())
        if not 0.0 <= low <= high < float("inf") or high - low < LEAST_SPREAD * high or high == 0.0:
            return False
        sides.append(track > (low + high) / 2.0)
    return len(np.unique(sides[0] * 2 + sides[1])) == 4
