"""Drift of an encoder from its active correction table.

Dust, wear, heat and a shifted head change the tracks slowly. No single sample shows it: the position
error is small and repeats at the same phase of the cycle. Comparing a new reference measurement with
the active table shows it early.
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
    """Present error of the active table, in cycles, without its constant part.

    rms    over the cycle, weighted by distance
    peak   the largest
    Both include the uncertainty of the new measurement
    (``uncertainty_rms`` and ``uncertainty_peak`` of :class:`canfb.Calibration`).
    """

    rms: float
    peak: float


def drift(fresh: Calibration, table: CorrectionTable | None, conditioning: Conditioning = IDENTITY) -> Drift:
    """Drift of the encoder measured by ``fresh`` from ``table`` and ``conditioning``.

    ``table`` and ``conditioning`` are the active ones; None is the identity. The constant part of
    the difference is removed, because the origin of the phase is a convention. If the conditionings
    differ, the phases that both give are compared on the tracks themselves. ValueError if ``fresh``
    has another conditioning and no ``tracks``, TypeError for arguments of another type.
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
    moved = np.abs(wrap(np.diff(fresh)))
    weights = (np.append(moved, 0.0) + np.append(0.0, moved)) / 2.0
    off = active - fresh
    nowhere = np.isnan(off)  # the tracks as conditioned go through zero: no phase at all
    off[nowhere] = 0.0
    off = about_mean(off, weights=weights)
    off -= np.average(off, weights=weights)
    off[nowhere] = 0.5
    first, last = off[:-1], off[1:]
    square = np.average((first * first + first * last + last * last) / 3.0, weights=moved)
    return Drift(float(np.sqrt(square)), float(np.abs(off).max()))
