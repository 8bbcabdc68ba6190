"""The chain over arrays, in blocks that stay in the processor's cache."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from canfb.signal.blocks import blocks
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import CorrectionTable
from canfb.signal.phase import raw_phase_block, wrap_block
from canfb.signal.tracker import RESIDUAL_LIMIT, Tracker, TrackResult, track_block


def process(
    sine: npt.ArrayLike,
    cosine: npt.ArrayLike,
    table: CorrectionTable | None = None,
    residual_limit: float = RESIDUAL_LIMIT,
    conditioning: Conditioning | None = None,
) -> TrackResult:
    """Tracks to positions: conditioning, Table 1, correction table, eq. 9 and eq. 12.

    ``sine`` and ``cosine`` have shape (n,), ADC counts, zero at mid-scale. The result is
    bit for bit that of :func:`canfb.phase_in_cycle`, ``table`` and :class:`canfb.Tracker`
    one sample after the other. A sample with both tracks zero has no phase: its position
    is predicted and marked not ok. ValueError if the shapes differ.
    """
    sines, cosines = _numbers(sine), _numbers(cosine)
    if sines.ndim != 1 or sines.shape != cosines.shape:
        raise ValueError(f"sine and cosine must be of one length: {sines.shape} and {cosines.shape}")
    result = TrackResult.empty(len(sines))
    tracker = Tracker(residual_limit)
    for part, scratch in blocks(len(sines)):
        s, c, phase = sines[part], cosines[part], result.phase[part]
        if conditioning is not None:
            s, c = conditioning.apply(s.astype(np.float64), c.astype(np.float64))
        raw_phase_block(s, c, phase, scratch)
        if table is None:
            wrap_block(phase, scratch)
        else:
            table.correct_block(phase, phase, scratch)
        track_block(tracker, result, part, scratch)
    return result


def _numbers(track: npt.ArrayLike) -> npt.NDArray[Any]:
    """The track as it is if its numbers are integers or floats, else as float64."""
    numbers = np.asarray(track)
    return numbers if numbers.dtype.kind in "iuf" else numbers.astype(np.float64)
