"""The chain over arrays, in blocks that stay in the processor's cache."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import CorrectionTable
from canfb.signal.phase import raw_phases
from canfb.signal.tracker import RESIDUAL_LIMIT, Tracker, TrackResult, track_block

# 8192 samples x 8 bytes x a dozen temporaries stay inside a usual second-level cache.
BLOCK_SAMPLES = 8192


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
    sines, cosines = np.asarray(sine), np.asarray(cosine)
    if sines.ndim != 1 or sines.shape != cosines.shape:
        raise ValueError(f"sine and cosine must be of one length: {sines.shape} and {cosines.shape}")
    n = len(sines)
    result = TrackResult(np.empty(n, np.int64), np.empty(n), np.empty(n), np.empty(n, np.bool_))
    tracker = Tracker(residual_limit)
    for start in range(0, n, BLOCK_SAMPLES):
        part = slice(start, start + BLOCK_SAMPLES)
        s, c = sines[part].astype(np.float64), cosines[part].astype(np.float64)
        if conditioning is not None:
            s, c = conditioning.apply(s, c)
        phases = raw_phases(s, c)
        if table is not None:
            phases = table.correct_array(phases)
        block = track_block(tracker, phases)
        result.cycles[part], result.phase[part] = block.cycles, block.phase
        result.residual[part], result.ok[part] = block.residual, block.ok
    return result
