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

FloatArray = npt.NDArray[np.float64]

NO_PHASE = math.nan


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
    """
    if isinstance(sine, (int, float, np.generic)) and isinstance(cosine, (int, float, np.generic)):
        return raw_phase(float(sine), float(cosine))
    s, c = np.broadcast_arrays(np.asarray(sine, dtype=np.float64), np.asarray(cosine, dtype=np.float64))
    return raw_phases(s, c)


def raw_phase(s: float, c: float) -> float:
    """Table 1 for one sample; NaN when both tracks are zero."""
    if abs(s) > abs(c):
        phase = (0.25 if s > 0.0 else 0.75) - 0.125 * (c / s)
    elif c > 0.0:
        phase = 0.125 * (s / c)
        if phase < 0.0:
            phase += 1.0
    elif c < 0.0:
        phase = 0.5 + 0.125 * (s / c)
    else:
        return NO_PHASE
    # A tiny negative sine rounds up to 1.0, which is phase 0; adding 0.0 turns -0.0 into 0.0.
    return phase + 0.0 if phase < 1.0 else (0.0 if phase == 1.0 else NO_PHASE)


def raw_phases(s: FloatArray, c: FloatArray) -> FloatArray:
    """Table 1 for arrays: the same operations as :func:`raw_phase`, hence the same bits."""
    steep = np.abs(s) > np.abs(c)
    numerator = np.where(steep, -c, s)
    denominator = np.where(steep, s, c)
    with np.errstate(invalid="ignore", divide="ignore"):
        phase = numerator / denominator
        phase *= 0.125
        # Quarter of the cycle: 0 and 1/2 where the cosine is larger, 1/4 and 3/4 where the sine is.
        phase += 0.25 * steep + 0.5 * (denominator < 0.0)
        phase += phase < 0.0
        phase *= phase != 1.0
    return phase
