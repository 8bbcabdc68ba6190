"""The supervised chain over a stream of arrays: bit for bit as sample by sample, faults included.

The stages of one sample are computed for a whole block, then eq. 9 up to the first sample that a check
rejects. That sample, and those after it that decide on the position, go through
:class:`canfb.signal.stages.Stages` one by one.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from canfb.signal.blocks import BLOCK_SAMPLES, Scratch, aligned, scratch_for
from canfb.signal.chain_config import ChainConfig, with_correction
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import AnyTable, CorrectionTable, correction_of
from canfb.signal.phase import AnyArray, FloatArray, check_counts, pair_of_tracks, raw_phase_block, wrap_block
from canfb.signal.stages import Stages
from canfb.signal.supervision import LOST, RESIDUAL, VALID, SampleLimits
from canfb.signal.tracker import RESIDUAL_LIMIT, TrackResult

# The fixed cost of arrays is that of some single samples: fewer than these are taken one by one.
SHORTEST_BLOCK = 16
SHORTEST_RUN = 10
# Length of a run after a fault that only eq. 9 shows: another fault may be near, and the samples after it
# would be computed in vain. It doubles with each run without a fault, so that less than half is in vain.
FIRST_RUN = 32


BIG = 1e150  # no count of any converter, and its square is a float
NO_LIMITS = SampleLimits(int(BIG), 0.0, 10.0 * BIG)


@dataclass(frozen=True)
class ChainResult:
    """Positions of a block of samples: arrays of one length, as the fields of :class:`canfb.Feedback`.

    cycles, phase    the position: int64 and float64 (cycles, 0..1); predicted while coasting
    residual         eq. 12, cycles, 0..0.5; 0.5 if there was nothing to compare
    amplitude        of the conditioned tracks, counts
    raw_phase        Table 1, cycles, 0..1; NaN without a phase
    status           uint16, status word 2011:01 (:class:`canfb.StatusBit`)
    """

    cycles: npt.NDArray[np.int64]
    phase: FloatArray
    residual: FloatArray
    amplitude: FloatArray
    raw_phase: FloatArray
    status: npt.NDArray[np.uint16]

    @classmethod
    def empty(cls, samples: int) -> ChainResult:
        """Arrays of this length, not initialised."""
        kinds = (np.int64, *[np.float64] * 4, np.uint16)
        return cls(*(aligned(samples, kind) for kind in kinds))

    def part(self, samples: slice) -> ChainResult:
        """Views of these samples."""
        return ChainResult(
            self.cycles[samples],
            self.phase[samples],
            self.residual[samples],
            self.amplitude[samples],
            self.raw_phase[samples],
            self.status[samples],
        )

    @property
    def valid(self) -> npt.NDArray[np.bool_]:
        """Status bit 0: the position may be used."""
        return (self.status & VALID).astype(np.bool_)


def process_stream(
    blocks: Iterable[tuple[npt.ArrayLike, npt.ArrayLike]],
    config: ChainConfig | None = None,
    table: AnyTable = None,
    speed_cycles: float | None = None,
) -> Iterator[ChainResult]:
    """The supervised chain over successive blocks of samples: one result for each block.

    A block is a pair (sine, cosine) of shape (n,), ADC counts, zero at mid-scale; n may differ and may be 0.
    Samples are one sampling interval apart, also across blocks. The results are bit for bit those of
    :meth:`canfb.SignalChain.step`, but none is valid after a start in motion without ``speed_cycles``. A
    block that is not such a pair ends the stream with the errors of :func:`canfb.process`.

    ``config`` None: the defaults of :class:`canfb.ChainConfig`; ``table`` None: the identity. ``table`` and
    ``speed_cycles`` as for :func:`canfb.process`. TypeError or ValueError at once for a bad argument.
    """
    config, alone = with_correction(ChainConfig() if config is None else config, table)
    stream = Stream(config, alone, 0.0 if speed_cycles is None else speed_cycles)
    results = (stream.take(*stream.tracks(block)) for block in blocks)
    return from_standstill(results, config) if speed_cycles is None else results


def from_standstill(results: Iterator[ChainResult], config: ChainConfig) -> Iterator[ChainResult]:
    first: list[float] = []
    moves = is_known = False
    for result in results:
        if not is_known:
            valid = result.valid
            begin = 0 if first or not valid.any() else int(valid.argmax())  # the first valid sample
            good = np.logical_and.accumulate(valid[begin:][: FIRST - len(first)])
            first += result.phase[begin:][: len(good)][good].tolist()
            is_known = len(first) == FIRST or (bool(first) and not good.all())
            moves = is_known and begins_in_motion(first, config)
        if moves:
            result.status[:] = result.status & ~np.uint16(VALID) | LOST
        yield result


class Stream:
    """:class:`Stages`, which hold all state from block to block, and memory for intermediate results.

    ``supervised`` False: without the limits of one sample; amplitude and raw phase are not computed.
    """

    def __init__(
        self,
        config: ChainConfig,
        table: CorrectionTable | None,
        speed_cycles: float,
        supervised: bool = True,
    ) -> None:
        if not config.interval_s and (config.conditioning.cosine_delay_s or config.adapt):
            what = "adapt" if config.adapt else "a conditioning with cosine_delay_s"
            raise ValueError(f"{what} needs interval_s, the sampling interval in seconds")
        self._stages = Stages(config, table)
        self._supervised = supervised
        if not supervised:
            self._stages.set_limits(replace(config.chain_limits, sample=NO_LIMITS))
        self._stages.restart(0, speed_cycles)
        self._table = table
        self._conditioning = None if config.conditioning.is_identity else config.conditioning
        self._bounds = config.limits.bounds()
        self._run_samples = FIRST_RUN
        self._is_first = True
        self._scratch = scratch_for(BLOCK_SAMPLES)

    def tracks(self, block: tuple[npt.ArrayLike, npt.ArrayLike]) -> tuple[AnyArray, AnyArray]:
        if not hasattr(block, "__len__"):
            raise ValueError(f"a block must be a pair (sine, cosine), not {type(block).__name__}")
        if len(block) != 2:
            raise ValueError(f"a block must be a pair (sine, cosine), not {len(block)} of them")
        may_be_offset = self._conditioning is not None
        sine, cosine = pair_of_tracks(*block, may_be_offset=may_be_offset)
        if self._is_first:  # a later block may look wrong by a fault, which is flagged
            check_counts(sine, cosine, may_be_offset=may_be_offset)
        self._is_first = False
        return sine, cosine

    def take(self, sine: AnyArray, cosine: AnyArray) -> ChainResult:
        samples = len(sine)
        result = ChainResult.empty(samples)
        for start in range(0, samples, BLOCK_SAMPLES):
            part = slice(start, min(start + BLOCK_SAMPLES, samples))
            self._take_part(_counts(sine[part]), _counts(cosine[part]), result.part(part))
        return result

    def _take_part(self, sine: AnyArray, cosine: AnyArray, result: ChainResult) -> None:
        samples = len(sine)
        # If a phase depends on speed or drift, samples need those before them, one by one.
        on_arrays = samples >= SHORTEST_BLOCK and not self._stages.tracks.depends_on_past
        bad = self._compute(sine, cosine, result) if on_arrays else []
        k = 0
        for fault in [*bad, samples]:
            while k < min(fault + 1, samples):
                if on_arrays and fault - k >= SHORTEST_RUN and self._stages.may_run:
                    k = self._run(k, fault, sine, cosine, result)
                else:
                    self._step(k, sine, cosine, result)
                    k += 1

    def _compute(self, sine: AnyArray, cosine: AnyArray, result: ChainResult) -> list[int]:
        scratch = self._scratch.head(len(sine))
        amplitude, raw = result.amplitude, result.raw_phase
        if not self._supervised:
            raw = result.phase if self._table is None else scratch.raw
        with np.errstate(over="ignore", invalid="ignore"):
            s, c = (
                (sine, cosine)
                if self._conditioning is None
                else self._conditioning.apply_block(sine, cosine, scratch)
            )
            if self._supervised:
                _amplitudes(s, c, amplitude, scratch)
            raw_phase_block(s, c, raw, scratch)
            if not raw.max() < 1.0:
                wrap_block(raw, scratch)
            if self._table is not None:
                self._table.correct_block(raw, result.phase, scratch)
            elif self._supervised:
                result.phase[:] = raw
        if self._supervised:
            return self._bad(sine, cosine, result)
        if raw.max() < math.inf and all(track.min() > -BIG and track.max() < BIG for track in (sine, cosine)):
            return []
        return np.flatnonzero(~(np.isfinite(raw) & (np.abs(sine) < BIG) & (np.abs(cosine) < BIG))).tolist()

    def _bad(self, sine: AnyArray, cosine: AnyArray, result: ChainResult) -> list[int]:
        lowest, highest, smallest, largest = self._bounds
        amplitude = result.amplitude
        least, most = amplitude.min(), amplitude.max()
        if least > 0.0 and smallest <= least and most <= largest and most < math.inf:
            if self._conditioning is None and most < min(-lowest, highest):
                return []
            if all(lowest < track.min() and track.max() < highest for track in (sine, cosine)):
                return []
        good = result.raw_phase == result.raw_phase
        good &= (amplitude >= smallest) & (amplitude <= largest)
        for track in (sine, cosine):
            good &= (track > lowest) & (track < highest)
        return np.flatnonzero(~good).tolist()

    def _run(self, k: int, fault: int, sine: AnyArray, cosine: AnyArray, result: ChainResult) -> int:
        length = min(fault - k, self._run_samples)
        run, scratch = slice(k, k + length), self._scratch.head(length)
        ok = scratch.bits[1]  # not in use any more
        tracked = TrackResult(result.cycles[run], result.phase[run], result.residual[run], ok)
        taken = self._stages.follow_run(sine[run], cosine[run], tracked, scratch)
        status = result.status[k : k + taken]
        if self._stages.estimator.lost:
            status[:] = LOST | self._stages.base_status
            status[~ok[:taken]] |= RESIDUAL
        else:
            status[:] = VALID | self._stages.base_status
        k += taken
        if taken < length:
            self._run_samples = FIRST_RUN
            self._step(k, sine, cosine, result)
            return k + 1
        if length == self._run_samples:
            self._run_samples = min(2 * length, BLOCK_SAMPLES)
        return k

    def _step(self, k: int, sine: AnyArray, cosine: AnyArray, result: ChainResult) -> None:
        got = self._stages.take(float(sine[k]), float(cosine[k]))
        result.cycles[k], result.phase[k], result.residual[k] = got.cycles, got.phase, got.residual
        result.amplitude[k], result.raw_phase[k] = got.amplitude, got.raw_phase
        result.status[k] = got.status


def _counts(track: AnyArray) -> AnyArray:
    return track if track.dtype in (np.float64, np.int16) else track.astype(np.float64)


def _amplitudes(s: AnyArray, c: AnyArray, out: FloatArray, scratch: Scratch) -> None:
    for track, square in ((s, out), (c, scratch.a)):
        if track.dtype == np.float64:
            np.multiply(track, track, out=square)
        else:
            square[:] = track
            square *= square
    out += scratch.a
    np.sqrt(out, out=out)


FIRST = 3  # samples that show a start in motion


def begins_in_motion(phases: Sequence[float], config: ChainConfig) -> bool:
    """True, with a warning, if the first two or three valid phases, cycles, show a motion; False for one."""
    if len(phases) < 2:
        return False
    first, second = (math.remainder(phases[n + 1] - phases[n], 1.0) for n in (0, len(phases) - 2))
    largest = config.max_acceleration_cycles or config.doubt_acceleration_cycles
    if abs(first - (second - first) / 2.0) <= 4.0 * config.phase_error_cycles + largest / 2.0:
        return False
    warnings.warn(
        "the tracks begin in motion, and several speeds fit their samples: no position is ok. Pass "
        "speed_cycles, the speed at the first sample in cycles per sample, right to less than half a cycle "
        "(0.0: the one nearest to standstill)",
        UserWarning,
        stacklevel=3,
    )
    return True


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
    less than half a cycle; None: standstill, and if the first samples show a motion, nothing is ``ok``
    and a UserWarning is given: phases do not distinguish 0.2 from 83.2. ``declared``: any of
    max_acceleration_cycles, phase_error_cycles, bad_samples, doubt_acceleration_cycles, coast_samples,
    interval_s and adapt of :class:`canfb.ChainConfig`; cosine_delay_s and adapt need interval_s.

    Bit for bit :class:`canfb.SignalChain` without limits on amplitude and converter; ``ok`` is status bit
    0, position valid. ValueError for arrays that are not such tracks (wrong shape, complex, unsigned or
    never centred, in -1..1), for a bad limit or speed, and for the table of a calibration without its
    conditioning; TypeError for another type of table or conditioning.
    """
    if conditioning is not None and not isinstance(conditioning, Conditioning):
        raise TypeError(f"conditioning must be a Conditioning or None, not {type(conditioning).__name__}")
    used = correction_of(table, conditioning)
    unknown = declared.keys() - DECLARED
    if unknown:
        raise TypeError(f"process() has no option {min(unknown)!r}; it takes {', '.join(DECLARED)}")
    config = ChainConfig(residual_limit=residual_limit, conditioning=used.conditioning, **declared)
    stream = Stream(config, used.table, 0.0 if speed_cycles is None else speed_cycles, supervised=False)
    results = iter([stream.take(*stream.tracks((sine, cosine)))])
    (result,) = from_standstill(results, config) if speed_cycles is None else results
    return TrackResult(result.cycles, result.phase, result.residual, result.valid)
