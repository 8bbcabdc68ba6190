"""Samples through the chain of the module, without the module: what its supervision makes of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from canfb.master.samples import TrackSamples
from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import ChainConfig, ChainLimits
from canfb.signal.correction import Correction
from canfb.signal.phase import FloatArray
from canfb.signal.sample import TICK_S, TICKS, Sample
from canfb.signal.supervision import AMPLITUDE, CLIPPED, FROZEN, LOST, RESIDUAL, VALID

FLAGS = {"residual": RESIDUAL, "amplitude": AMPLITUDE, "clipped": CLIPPED, "frozen": FROZEN, "lost": LOST}
"""What a sample may be flagged with by its own counts, and its bit of the status word."""


@dataclass(frozen=True, eq=False)
class SupervisedSamples:
    """The chain's account of each sample: arrays of one length.

    position     cycles since the first sample, NaN where it was not valid
    amplitude    counts, after conditioning; NaN where there was no sample
    status       status word, 2011:01
    elapsed      sampling intervals since the sample before, 1 without sample times
    """

    position: FloatArray
    amplitude: FloatArray
    status: npt.NDArray[np.int64]
    elapsed: FloatArray

    @property
    def valid(self) -> npt.NDArray[np.bool_]:
        """Where the position may be used and was measured."""
        return np.isfinite(self.position)

    @property
    def flagged(self) -> dict[str, int]:
        """Samples with each of :data:`FLAGS`, of those that have any."""
        counts = {name: int(np.count_nonzero(self.status & bit)) for name, bit in FLAGS.items()}
        return {name: count for name, count in counts.items() if count}

    @property
    def speed(self) -> FloatArray:
        """Cycles per sampling interval at each sample but the first, NaN where it is not known."""
        speed: FloatArray = np.diff(self.position) / self.elapsed[1:]
        return speed


def supervise(
    samples: TrackSamples, used: Correction, limits: ChainLimits, speed_cycles: float
) -> SupervisedSamples:
    """Take the samples through the chain, as the module does that has these limits.

    ``speed_cycles`` is the speed at the first sample, cycles per interval, right to half a cycle. The
    samples have a rate.
    """
    chain = SignalChain(ChainConfig(), used.table)
    chain.set_limits(limits)
    chain.activate(used)
    if samples.rate_hz:
        chain.interval_s = 1.0 / samples.rate_hz
    chain.restart(0, speed_cycles)
    count = len(samples)
    cycles, phase = np.zeros(count, np.int64), np.full(count, math.nan)
    amplitude, status = np.full(count, math.nan), np.zeros(count, np.int64)
    stamps = [None] * count if samples.time_s is None else _stamps(samples.time_s)
    tracks = zip(samples.sine.tolist(), samples.cosine.tolist(), stamps, strict=True)
    for k, (sine, cosine, stamp) in enumerate(tracks):
        if math.isnan(sine) or math.isnan(cosine):
            status[k] = chain.miss().status
            continue
        found = chain.step(Sample(sine, cosine, time_100ns=stamp))
        status[k], amplitude[k] = found.status, found.amplitude
        if found.status & VALID:
            cycles[k], phase[k] = found.cycles, found.phase
    seen = np.isfinite(phase)
    origin = int(cycles[seen][0]) if seen.any() else 0
    return SupervisedSamples((cycles - origin) + phase, amplitude, status, _elapsed(samples))


def _stamps(time_s: FloatArray) -> list[int | None]:
    """As 2000:05 has them."""
    return [int(ticks) % TICKS for ticks in np.rint(time_s / TICK_S).tolist()]


def _elapsed(samples: TrackSamples) -> FloatArray:
    elapsed = np.ones(len(samples))
    if samples.time_s is not None and samples.rate_hz:
        elapsed[1:] = np.diff(samples.time_s) * samples.rate_hz
    return elapsed
