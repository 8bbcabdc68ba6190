"""How far an encoder has moved away from the correction table that is in force.

Dust, wear, heat and a head that has shifted change the tracks slowly. No single sample shows it:
the position is only a little off, again and again at the same place of the cycle. A fresh reference
measurement beside the active table shows it early.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from canfb.calibration.circular import about_mean
from canfb.calibration.result import Calibration
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.correction import CorrectionTable, check_table
from canfb.signal.phase import FloatArray, raw_phases, wrap


class Drift(NamedTuple):
    """Error that a table in force makes now, in cycles, its constant part taken off.

    rms    over the cycle, each part of the way alike
    peak   the largest
    Both hold the uncertainty of the fresh measurement as well
    (``uncertainty_rms`` and ``uncertainty_peak`` of :class:`canfb.Calibration`).
    """

    rms: float
    peak: float


def drift(fresh: Calibration, table: CorrectionTable | None, conditioning: Conditioning = IDENTITY) -> Drift:
    """How far the encoder, as ``fresh`` has just measured it, is from ``table`` and ``conditioning``.

    ``table`` and ``conditioning`` are those in force; None is the identity. The constant part of
    the difference is taken off, because where phase 0 lies is a convention. Conditionings that
    differ are taken into account: both ways from tracks to phase are compared on the tracks
    themselves. ValueError where ``fresh`` has another conditioning and no ``tracks``, TypeError
    for arguments of another type.
    """
    check_table(table)
    if not isinstance(fresh, Calibration) or not isinstance(conditioning, Conditioning):
        raise TypeError(
            "drift takes a Calibration, a CorrectionTable and a Conditioning, not "
            f"{type(fresh).__name__}, {type(table).__name__} and {type(conditioning).__name__}"
        )
    active = CorrectionTable.identity() if table is None else table
    if conditioning == fresh.conditioning:
        knots = [np.arange(len(one) + 1) / len(one) for one in (active, fresh.table)]
        raw = np.unique(np.concatenate(knots))
        return _compared(active(raw), fresh.table(raw))
    if fresh.tracks is None:
        raise ValueError(
            "the conditionings differ and the new measurement has no tracks: "
            "measure again with the active conditioning"
        )
    sine, cosine = np.append(fresh.tracks, fresh.tracks[:, :1], axis=1)
    return _compared(
        active(raw_phases(*conditioning.apply(sine, cosine))),
        fresh.table(raw_phases(*fresh.conditioning.apply(sine, cosine))),
    )


def _compared(active: FloatArray, fresh: FloatArray) -> Drift:
    """Two phases of the same places, once around; straight between the places."""
    way = np.abs(wrap(np.diff(fresh)))
    weights = (np.append(way, 0.0) + np.append(0.0, way)) / 2.0
    off = active - fresh
    nowhere = np.isnan(off)  # the tracks as conditioned go through zero: no phase at all
    off[nowhere] = 0.0
    off = about_mean(off, weights=weights)
    off -= np.average(off, weights=weights)
    off[nowhere] = 0.5
    first, last = off[:-1], off[1:]
    square = np.average((first * first + first * last + last * last) / 3.0, weights=way)
    return Drift(float(np.sqrt(square)), float(np.abs(off).max()))
