"""The chain over arrays, without the limits of single samples."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt

from canfb.signal.chain_config import ChainConfig
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import AnyTable, correction_of
from canfb.signal.stream import Stream, from_standstill
from canfb.signal.tracker import RESIDUAL_LIMIT, TrackResult
from canfb.signal.tracks import check_counts, pair_of_tracks

DECLARED = (
    "max_acceleration_cycles",
    "phase_error_cycles",
    "bad_samples",
    "doubt_acceleration_cycles",
    "coast_samples",
    "interval_s",
    "adapt",
)


def process(
    sine: npt.ArrayLike,
    cosine: npt.ArrayLike,
    table: AnyTable = None,
    residual_limit: float = RESIDUAL_LIMIT,
    conditioning: Conditioning | None = None,
    speed_cycles: float | None = None,
    **declared: Any,
) -> TrackResult:
    """Tracks to positions: conditioning, Table 1, correction table, eq. 9 and eq. 12.

    ``sine`` and ``cosine`` have shape (n,), ADC counts, zero at mid-scale. ``table`` is a
    correction table or a whole :class:`canfb.Calibration`, with its conditioning; None and ``conditioning``
    None are the identity. ``speed_cycles`` is the speed at the first sample, cycles per sample, right to
    less than half a cycle; None: standstill, and where the first samples show a motion nothing is ``ok``
    and a UserWarning says so: phases do not tell 0.2 from 83.2. ``declared``: any of
    max_acceleration_cycles, phase_error_cycles, bad_samples, doubt_acceleration_cycles, coast_samples,
    interval_s and adapt of :class:`canfb.ChainConfig`; cosine_delay_s and adapt need interval_s.

    Bit for bit :class:`canfb.SignalChain` without limits on amplitude and converter; ``ok`` is status bit
    0, position valid. ValueError for arrays that are not such tracks (wrong shape, complex, unsigned or
    never centred, in -1..1), for a bad limit or speed and for the table of a calibration whose conditioning
    is missing; TypeError for another type of table or
    conditioning.
    """
    if conditioning is not None and not isinstance(conditioning, Conditioning):
        raise TypeError(f"conditioning must be a Conditioning or None, not {type(conditioning).__name__}")
    used = correction_of(table, conditioning)
    may_be_offset = conditioning is not None or not used.conditioning.is_identity
    sines, cosines = pair_of_tracks(sine, cosine, may_be_offset=may_be_offset)
    check_counts(sines, cosines, may_be_offset=may_be_offset)
    unknown = declared.keys() - DECLARED
    if unknown:
        raise TypeError(f"process() has no option {min(unknown)!r}; it takes {', '.join(DECLARED)}")
    config = ChainConfig(residual_limit=residual_limit, conditioning=used.conditioning, **declared)
    if not config.interval_s and (config.conditioning.cosine_delay_s or config.adapt):
        what = "adapt" if config.adapt else "a conditioning with cosine_delay_s"
        raise ValueError(f"{what} needs interval_s, the sampling interval in seconds")
    stream = Stream(config, used.table, speed_cycles or 0.0, supervised=False)
    results = iter([stream.take(sines, cosines)])
    (result,) = from_standstill(results, config) if speed_cycles is None else results
    return TrackResult(result.cycles, result.phase, result.residual, result.valid)
