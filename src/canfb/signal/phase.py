"""Phase within the cycle by division (Hoescheler and Szamel 1997, Table 1).

The smaller track is divided by the larger one, so a common amplitude error cancels. On
ideal tracks the raw phase is off by up to 1.132 % of a cycle; the correction table takes
that out together with the errors of the individual encoder.

The last column of the printed table reads 1 + s/c; it must be 1 + s/(8c), else the curve
would jump at 7/8.
"""

from __future__ import annotations

import math
from typing import Any, overload

import numpy as np
import numpy.typing as npt

from canfb.signal.blocks import Scratch, blocks

FloatArray = npt.NDArray[np.float64]

NO_PHASE = math.nan
SCALARS = (int, float, np.floating, np.integer, np.bool_)


@overload
def phase_in_cycle(sine: float, cosine: float) -> float: ...
@overload
def phase_in_cycle(sine: npt.ArrayLike, cosine: npt.ArrayLike) -> FloatArray: ...
def phase_in_cycle(sine: Any, cosine: Any) -> Any:
    """Raw phase of one sample, or of arrays of samples, in cycles: 0 <= raw phase < 1 (Table 1).

    ``sine`` and ``cosine`` have any common unit and any size; arrays are broadcast
    against each other. Phase 0 is the positive zero crossing of the sine track.
    The result is NaN where there is no phase: both tracks zero, or not a number.
    A float for scalars, an ndarray of float64 for arrays; both give the same bits.
    ValueError for complex numbers.
    """
    if isinstance(sine, SCALARS) and isinstance(cosine, SCALARS):
        return raw_phase(float(sine), float(cosine))
    s, c = np.broadcast_arrays(real_array("sine", sine), real_array("cosine", cosine))
    return raw_phases(s, c)


def real_array(name: str, values: npt.ArrayLike) -> FloatArray:
    """``values`` as an array of float64; ValueError, with this name, for complex numbers."""
    if np.iscomplexobj(values):
        raise ValueError(f"{name} must be real numbers, not complex ones")
    return np.asarray(values, dtype=np.float64)


def wrap(cycles: FloatArray) -> FloatArray:
    """Differences of phases to -0.5..0.5 cycle: the nearest of all that differ by whole cycles."""
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
    if s < 0.0:
        return 0.75 - 0.125 * (c / s)
    return NO_PHASE


def raw_phases(s: FloatArray, c: FloatArray) -> FloatArray:
    """Table 1 for arrays of one shape: the same operations as :func:`raw_phase`, hence the same bits."""
    phases = np.empty(s.shape)
    flat_s, flat_c, flat = s.reshape(-1), c.reshape(-1), phases.reshape(-1)
    for part, scratch in blocks(len(flat)):
        raw_phase_block(flat_s[part], flat_c[part], flat[part], scratch)
        wrap_block(flat[part], scratch)
    return phases


# By octant: 4 if the cosine is negative, + 2 if the sine is, + 1 if the sine is the larger one. The
# raw phase is |base - ratio / 8|: a row of Table 1 with a plus has its base with a minus.
OCTANT_BASE = np.array([-0.0, 0.25, 1.0, -0.75, 0.5, -0.25, -0.5, 0.75])


def raw_phase_block(s: npt.NDArray[Any], c: npt.NDArray[Any], out: FloatArray, scratch: Scratch) -> None:
    """Table 1 for one block of integers or floats, into ``out``: raw phases 0..1.

    1.0 stands for 0.0 here, which a correction table and :func:`wrap_block` take for the same.
    The octants are looked up rather than chosen by conditions: on a turning machine the
    processor guesses such a choice wrong, and each wrong guess costs more than all the
    arithmetic of a sample.
    """
    smaller, larger, octant, index, bit = scratch.a, scratch.b, scratch.octant, scratch.index, scratch.bit
    digit = bit.view(np.int8)
    # float64 before the absolute value: that of the lowest int16 is no int16.
    np.abs(s, out=smaller, dtype=np.float64)
    np.abs(c, out=larger, dtype=np.float64)
    np.less(c, 0, out=bit)
    np.add(digit, digit, out=octant)
    np.less(s, 0, out=bit)
    octant += digit
    octant += octant
    np.greater(smaller, larger, out=bit)
    octant += digit
    np.minimum(smaller, larger, out=out)
    np.maximum(smaller, larger, out=larger)
    with np.errstate(invalid="ignore"):
        out /= larger
    out *= 0.125
    index[:] = octant
    base = OCTANT_BASE.take(index, mode="clip", out=smaller)  # "clip": the other mode makes a copy
    np.subtract(base, out, out=out)
    np.abs(out, out=out)


def wrap_block(phases: FloatArray, scratch: Scratch) -> None:
    """Take phases of -1 <= phase < 2 into 0..1, in place; 1.0 only where a tiny negative one was.

    By floor, because numpy turns the truth values of a condition into numbers one by one.
    """
    phases -= np.floor(phases, out=scratch.a)
