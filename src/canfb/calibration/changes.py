"""Whether the tracks stay the same during a measurement: tables of parts of its time, compared.

Offsets drift while electronics warm up, a plug moves, a track is exchanged. One table of all samples is then
right at no time, and parts that are spread over all of the time (every second block) agree all the same.
Parts one after the other do not: their tables differ by more than each is uncertain by itself. A difference
of two tables with d degrees of freedom, in units of its uncertainty, is chi^2 / d; with d = 4, offsets, gains
and phase error, three times the uncertainty is passed by noise in 3e-7 of all pairs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from canfb.calibration.motion_blocks import BoolArray, IntArray
from canfb.signal.phase import FloatArray

SIGNIFICANT = 3.0
THIRDS, FINE = 3, 9  # parts: thirds see a slow drift best, shorter ones what happens near either end
MIN_RUN = 3


class Change(NamedTuple):
    """Largest significant difference of two tables, cycles, rms over the cycle and peak; 0: none."""

    rms: float = 0.0
    peak: float = 0.0


def lasting(out: BoolArray) -> list[IntArray]:
    """Runs of blocks or cycles that were left out: faults do not last, changed tracks do."""
    edges = np.flatnonzero(np.diff(out, prepend=False, append=False)).reshape(-1, 2)
    return [np.arange(first, last) for first, last in edges if last - first >= MIN_RUN]


def largest_change(tables: FloatArray, noise: FloatArray) -> Change:
    """Of tables, cycles, shape (parts, phases), uncertain by ``noise``, cycles rms, shape (parts,)."""
    centred = tables - tables.mean(axis=1, keepdims=True)
    found = Change()
    for first, second in zip(*np.triu_indices(len(centred), 1), strict=True):
        off = centred[first] - centred[second]
        square, expected = float(np.mean(off**2)), float(noise[first] ** 2 + noise[second] ** 2)
        if square > SIGNIFICANT**2 * expected:
            one = Change(float(np.sqrt(square - expected)), float(np.abs(off).max()))
            found = max(found, one)
    return found
