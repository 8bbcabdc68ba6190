"""The supervised chain over a stream of arrays: bit for bit as sample by sample, faults included.

Nearly all samples of a recording are good, and a good sample needs none of the decisions
that :class:`canfb.signal.chain.SignalChain` is made of. So all values of single
samples are computed at once, then eq. 9 from the chain's state up to the first sample that
a check rejects. This one, and those after it that decide the position, go through the
chain one by one.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from canfb.signal.blocks import BLOCK_SAMPLES, Scratch
from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import ChainConfig
from canfb.signal.correction import CorrectionTable
from canfb.signal.phase import FloatArray, raw_phase_block, wrap_block
from canfb.signal.sample import Sample
from canfb.signal.supervision import LOST, RESIDUAL, TABLE_ACTIVE, VALID
from canfb.signal.tracker import TrackResult
from canfb.signal.tracks import check_counts, pair_of_tracks

# The prediction needs the two or three samples before.
BEFORE = 3
# To start on arrays takes as long as some single samples; fewer than these are taken one by one.
SHORTEST_BLOCK = 16
SHORTEST_RUN = 10
# After a fault that only eq. 9 shows: the next one may be near, and what lies behind it is computed
# in vain. The run is twice as long each time it ends well, so that this is never the larger part.
FIRST_RUN = 32


@dataclass(frozen=True)
class ChainResult:
    """Positions of a block of samples: arrays of one length, as the fields of :class:`canfb.Feedback`.

    cycles, phase    the position: int64 and float64 (cycles, 0..1); the predicted one while coasting
    residual         eq. 12, cycles, 0..0.5; 0.5 when there was nothing to compare
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
        """Arrays of this length, any content."""
        phase, residual, amplitude, raw_phase = (np.empty(samples) for _ in range(4))
        cycles, status = np.empty(samples, np.int64), np.empty(samples, np.uint16)
        return cls(cycles, phase, residual, amplitude, raw_phase, status)

    @property
    def valid(self) -> npt.NDArray[np.bool_]:
        """Status bit 0: where the position may be used."""
        return (self.status & VALID).astype(np.bool_)


def process_stream(
    blocks: Iterable[tuple[npt.ArrayLike, npt.ArrayLike]],
    config: ChainConfig | None = None,
    table: CorrectionTable | None = None,
    speed_cycles: float = 0.0,
) -> Iterator[ChainResult]:
    """The supervised chain over blocks of samples that follow each other: one result for each.

    A block is a pair (sine, cosine) of shape (n,), ADC counts, zero at mid-scale; n may differ
    from block to block and may be 0. The samples are one sampling interval apart, also across
    blocks. The results are bit for bit those of :meth:`canfb.SignalChain.step`, sample by
    sample: a bad sample is flagged in its status, and a lost position stays lost. Memory is
    bounded by the longest block. At a block that is not such a pair the stream ends, with the errors of
    :func:`canfb.process`.

    ``config`` None stands for the defaults of :class:`canfb.ChainConfig`, ``table`` None for the identity.
    ``speed_cycles`` is the speed at the first sample, cycles per sample, right to less than half a
    cycle; default: standstill. At another speed the position is lost from the second sample on, where
    its residual shows it. TypeError or ValueError at once for a bad one of these.
    """
    stream = _Stream(ChainConfig() if config is None else config, table, speed_cycles)
    return (stream.take(*stream.tracks(block)) for block in blocks)


class _Stream:
    """A :class:`SignalChain`, which is all that is carried from block to block, and memory to compute in."""

    def __init__(self, config: ChainConfig, table: CorrectionTable | None, speed_cycles: float) -> None:
        self._chain = SignalChain(config, table)
        self._chain.restart(0, speed_cycles)
        self._table = table
        self._conditioning = None if config.conditioning.is_identity else config.conditioning
        self._bounds = config.limits.bounds()
        self._base_status = 0 if table is None else TABLE_ACTIVE
        self._run_samples = FIRST_RUN
        self._is_first = True
        # All with room for the samples before.
        self._sine, self._cosine = np.zeros(BEFORE + BLOCK_SAMPLES), np.zeros(BEFORE + BLOCK_SAMPLES)
        self._tracked = TrackResult.empty(BEFORE + BLOCK_SAMPLES)
        self._scratch = Scratch(BLOCK_SAMPLES)
        self._good = np.empty(BLOCK_SAMPLES, np.bool_)

    def tracks(self, block: tuple[npt.ArrayLike, npt.ArrayLike]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """The arrays of the next block; ValueError if it is not such a pair."""
        if not hasattr(block, "__len__"):
            raise ValueError(f"a block must be a pair (sine, cosine), not {type(block).__name__}")
        if len(block) != 2:
            raise ValueError(f"a block must be a pair (sine, cosine), not {len(block)} of them")
        may_be_offset = self._conditioning is not None
        sine, cosine = pair_of_tracks(*block, may_be_offset=may_be_offset)
        if self._is_first:  # a later one may be so because of a fault, which is flagged
            check_counts(sine, cosine, may_be_offset=may_be_offset)
        self._is_first = False
        return sine, cosine

    def take(self, sine: npt.NDArray[np.generic], cosine: npt.NDArray[np.generic]) -> ChainResult:
        """One block, in parts that stay in the processor's cache."""
        result = ChainResult.empty(len(sine))
        for start in range(0, len(sine), BLOCK_SAMPLES):
            stop = min(start + BLOCK_SAMPLES, len(sine))
            room = slice(BEFORE, BEFORE + stop - start)
            self._sine[room], self._cosine[room] = sine[start:stop], cosine[start:stop]
            if stop - start < SHORTEST_BLOCK:
                for k in range(stop - start):
                    self._step(k, result, start)
            else:
                self._take_part(result, start, stop)
        return result

    def _take_part(self, result: ChainResult, start: int, stop: int) -> None:
        bad = self._compute(result, slice(start, stop)).tolist()
        bad.append(stop - start)
        k = 0
        for fault in bad:
            while k < fault:
                if self._chain.is_steady and fault - k >= SHORTEST_RUN:
                    k = self._run(k, fault, result, start)
                else:
                    self._step(k, result, start)
                    k += 1
            if k < stop - start:
                self._step(k, result, start)
                k += 1

    def _compute(self, result: ChainResult, part: slice) -> npt.NDArray[np.intp]:
        """All that depends on one sample alone; the samples that do not keep the limits."""
        samples = part.stop - part.start
        room = slice(BEFORE, BEFORE + samples)
        sine, cosine, good = self._sine[room], self._cosine[room], self._good[:samples]
        scratch, bit = self._scratch.head(samples), self._scratch.bit[:samples]
        amplitude, raw, phase = result.amplitude[part], result.raw_phase[part], self._tracked.phase[room]
        lowest, highest, smallest, largest = self._bounds
        with np.errstate(over="ignore", invalid="ignore"):
            s, c = (sine, cosine) if self._conditioning is None else self._conditioning.apply(sine, cosine)
            np.multiply(s, s, out=amplitude)
            np.multiply(c, c, out=scratch.a)
            amplitude += scratch.a
            np.sqrt(amplitude, out=amplitude)
            raw_phase_block(s, c, raw, scratch)
            wrap_block(raw, scratch)
            if self._table is None:
                phase[:] = raw
            else:
                self._table.correct_block(raw, phase, scratch)
        np.equal(raw, raw, out=good)
        good &= np.greater_equal(amplitude, smallest, out=bit)
        good &= np.less_equal(amplitude, largest, out=bit)
        for track in (sine, cosine):
            good &= np.greater(track, lowest, out=bit)
            good &= np.less(track, highest, out=bit)
        np.logical_not(good, out=bit)
        return np.flatnonzero(bit)

    def _run(self, k: int, fault: int, result: ChainResult, start: int) -> int:
        """Samples k..fault or fewer on arrays, and one more if that one has a fault; where to go on."""
        length = min(fault - k, self._run_samples)
        run = slice(BEFORE + k, BEFORE + k + length)
        tracked = self._tracked
        taken = self._chain.follow_run(self._sine, self._cosine, tracked, run, self._scratch.head(length))
        done, here = slice(start + k, start + k + taken), slice(run.start, run.start + taken)
        result.cycles[done] = tracked.cycles[here]
        result.phase[done] = tracked.phase[here]
        result.residual[done] = tracked.residual[here]
        status = result.status[done]
        if self._chain.lost:
            status[:] = LOST | self._base_status
            status[~tracked.ok[here]] |= RESIDUAL
        else:
            status[:] = VALID | self._base_status
        k += taken
        if taken < length:
            self._run_samples = FIRST_RUN
            self._step(k, result, start)
            return k + 1
        if length == self._run_samples:
            self._run_samples = min(2 * length, BLOCK_SAMPLES)
        return k

    def _step(self, k: int, result: ChainResult, start: int) -> None:
        """One sample through the chain."""
        got = self._chain.step(Sample(float(self._sine[BEFORE + k]), float(self._cosine[BEFORE + k])))
        at = start + k
        result.cycles[at], result.phase[at], result.residual[at] = got.cycles, got.phase, got.residual
        result.amplitude[at], result.raw_phase[at], result.status[at] = (
            got.amplitude,
            got.raw_phase,
            got.status,
        )
