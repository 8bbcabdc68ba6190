"""The chain over arrays, in blocks that stay in the processor's cache."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from canfb.signal.blocks import BLOCK_SAMPLES, Scratch, blocks
from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import ChainConfig
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.correction import CorrectionTable, check_table
from canfb.signal.estimator import Estimator
from canfb.signal.estimator_runs import follow_run, take_run
from canfb.signal.phase import AnyArray, FloatArray, raw_phase_block, wrap_block
from canfb.signal.sample import Sample
from canfb.signal.supervision import VALID, SampleLimits
from canfb.signal.tracker import RESIDUAL_LIMIT, TrackResult
from canfb.signal.tracking import continues
from canfb.signal.tracks import check_counts, pair_of_tracks

# After a fault the next one may be near, and what lies behind it is computed in vain.
FIRST_RUN = 64
DECLARED = (
    "max_acceleration_cycles",
    "phase_error_cycles",
    "bad_samples",
    "doubt_acceleration_cycles",
    "coast_samples",
    "interval_s",
    "adapt",
)
NO_LIMITS = SampleLimits(1 << 62, 0.0, math.inf)


def process(
    sine: npt.ArrayLike,
    cosine: npt.ArrayLike,
    table: CorrectionTable | None = None,
    residual_limit: float = RESIDUAL_LIMIT,
    conditioning: Conditioning | None = None,
    speed_cycles: float = 0.0,
    **declared: Any,
) -> TrackResult:
    """Tracks to positions: conditioning, Table 1, correction table, eq. 9 and eq. 12.

    ``sine`` and ``cosine`` have shape (n,), ADC counts, zero at mid-scale. ``table`` None and
    ``conditioning`` None are the identity. ``speed_cycles`` is the speed at the first sample, cycles per
    sample, right to less than half a cycle; phases do not tell 0.2 from 83.2. ``declared``: any of
    max_acceleration_cycles, phase_error_cycles, bad_samples, doubt_acceleration_cycles, coast_samples,
    interval_s and adapt of :class:`canfb.ChainConfig`; cosine_delay_s and adapt need interval_s.

    Bit for bit :class:`canfb.SignalChain` without limits on amplitude and converter; ``ok`` is status bit
    0, position valid. ValueError for arrays that are not such tracks (wrong shape, complex, unsigned or
    never centred, in -1..1) and for a bad limit or speed; TypeError for another type of table or
    conditioning.
    """
    check_table(table)
    if conditioning is not None and not isinstance(conditioning, Conditioning):
        raise TypeError(f"conditioning must be a Conditioning or None, not {type(conditioning).__name__}")
    may_be_offset = conditioning is not None
    sines, cosines = pair_of_tracks(sine, cosine, may_be_offset=may_be_offset)
    check_counts(sines, cosines, may_be_offset=may_be_offset)
    unknown = declared.keys() - DECLARED
    if unknown:
        raise TypeError(f"process() has no option {min(unknown)!r}; it takes {', '.join(DECLARED)}")
    config = ChainConfig(
        residual_limit=residual_limit,
        conditioning=conditioning or IDENTITY,
        **declared,
    )
    if config.conditioning.cosine_delay_s or config.adapt:
        return _one_by_one(sines, cosines, config, table, speed_cycles)
    follower = _Follower(config, speed_cycles)
    result = TrackResult.empty(len(sines))
    for part, scratch in blocks(len(sines)):
        s, c, phase = sines[part], cosines[part], result.phase[part]
        if conditioning is not None:
            s, c = conditioning.apply_block(s, c, scratch)
        if table is None:
            raw_phase_block(s, c, phase, scratch)
            wrap_block(phase, scratch)
        else:
            raw_phase_block(s, c, scratch.raw, scratch)
            table.correct_block(scratch.raw, phase, scratch)
        follower.take(result, part, scratch)
    return result


def _one_by_one(
    sines: AnyArray,
    cosines: AnyArray,
    config: ChainConfig,
    table: CorrectionTable | None,
    speed_cycles: float,
) -> TrackResult:
    if not config.interval_s:
        what = "adapt" if config.adapt else "a conditioning with cosine_delay_s"
        raise ValueError(f"{what} needs interval_s, the sampling interval in seconds")
    chain = SignalChain(config, table)
    chain.set_limits(replace(config.chain_limits, sample=NO_LIMITS))
    chain.restart(0, speed_cycles)
    result = TrackResult.empty(len(sines))
    for k, (sine, cosine) in enumerate(zip(sines.tolist(), cosines.tolist(), strict=True)):
        got = chain.step(Sample(sine, cosine))
        result.cycles[k], result.phase[k], result.residual[k] = got.cycles, got.phase, got.residual
        result.ok[k] = got.valid
    return result


def _gaps(phase: FloatArray) -> list[int]:
    """Where there is no phase."""
    return np.flatnonzero(np.isnan(phase)).tolist() if math.isnan(phase.max()) else []


class _Follower:
    """Eq. 9 over block after block, as far as nothing is in doubt; :class:`Estimator` for the rest."""

    def __init__(self, config: ChainConfig, speed_cycles: float) -> None:
        self._estimator = Estimator(config.chain_limits.declared)
        self._tracker = self._estimator.tracker
        self._estimator.restart(0, speed_cycles)
        self._run_samples = BLOCK_SAMPLES

    def take(self, result: TrackResult, part: slice, scratch: Scratch) -> None:
        """Fill ``result[part]`` from its phases, NaN where there is none."""
        at = part.start
        for gap in [*(part.start + gap for gap in _gaps(result.phase[part])), part.stop]:
            while at < gap:
                if self._may_run(result, at):
                    at = self._run(result, at, min(gap, at + self._run_samples), scratch)
                else:
                    self._take_one(result, at)
                    at += 1
            if gap < part.stop:
                self._take_one(result, gap)
                at = gap + 1

    def _may_run(self, result: TrackResult, at: int) -> bool:
        return not self._estimator.in_doubt and continues(self._tracker, result, at)

    def _run(self, result: TrackResult, start: int, stop: int, scratch: Scratch) -> int:
        state = self._tracker.state()
        end = follow_run(self._estimator, result, slice(start, stop), scratch)
        if end > start:
            take_run(self._estimator, state, result, start, end)
        else:
            self._tracker.set_state(*state)
        if self._estimator.lost:
            result.ok[start:end] = False
        if end == stop:
            self._run_samples = min(2 * self._run_samples, BLOCK_SAMPLES)
            return stop
        self._run_samples = FIRST_RUN
        self._take_one(result, end)
        return end + 1

    def _take_one(self, result: TrackResult, at: int) -> None:
        phase = float(result.phase[at])
        if math.isnan(phase):
            track, status = self._estimator.bad(1.0)
        else:
            track, status = self._estimator.good(phase, 1.0)
        result.cycles[at], result.phase[at], result.residual[at], _ = track
        result.ok[at] = bool(status & VALID)
