"""Samples through the chain of the module, without the module: what its supervision makes of them, and how
far the position is off at each speed, before and after a calibration.

What a smooth motion does not explain is the error within a cycle; its mean is the delay by the amplitude
(:mod:`canfb.calibration.path_fit`), less what the module adds for 2002:07.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from canfb.calibration.deviation import Deviation, best_of_phases
from canfb.calibration.motion_blocks import about_mean
from canfb.calibration.over_speeds import TracksAtSpeed, mean_speed
from canfb.calibration.path_fit import PathFit
from canfb.calibration.result import naming_speed
from canfb.errors import CalibrationError
from canfb.master.access import CommissioningError
from canfb.master.samples import TrackSamples
from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import ChainConfig, ChainLimits
from canfb.signal.correction import Correction
from canfb.signal.front_end import FrontEnd
from canfb.signal.harmonics import NO_LOW_PASS, Corners
from canfb.signal.phase import FloatArray, wrap
from canfb.signal.sample import TICK_S, TICKS, Sample
from canfb.signal.supervision import AMPLITUDE, CLIPPED, FROZEN, LOST, RESIDUAL, VALID

# What a sample may be flagged with by its own counts, and its bit of the status word.
FLAGS = {"residual": RESIDUAL, "amplitude": AMPLITUDE, "clipped": CLIPPED, "frozen": FROZEN, "lost": LOST}


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
    chain = SignalChain(ChainConfig())
    chain.set_limits(limits)
    chain.activate(used)
    if samples.rate_hz:
        chain.sync_interval_s = 1.0 / samples.rate_hz
    chain.restart(0, speed_cycles)
    count = len(samples)
    cycles, phase = np.zeros(count, np.int64), np.full(count, math.nan)
    amplitude, status = np.full(count, math.nan), np.zeros(count, np.int64)
    ticks = [] if samples.time_s is None else np.rint(samples.time_s / TICK_S).tolist()
    stamps: list[int | None] = [int(one) % TICKS for one in ticks]
    tracks = zip(samples.sine.tolist(), samples.cosine.tolist(), stamps or [None] * count, strict=True)
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


def _elapsed(samples: TrackSamples) -> FloatArray:
    elapsed = np.ones(len(samples))
    if samples.time_s is not None and samples.rate_hz:
        elapsed[1:] = np.diff(samples.time_s) * samples.rate_hz
    return elapsed


SETTLING_SAMPLES = 16  # until the chain knows the speed well
HELD_OUT = 0.25  # of the samples at each speed: not for the fit


@dataclass(frozen=True, eq=False)
class SpeedSamples:
    """Samples at a speed: cycles per second, with sign, right to half a cycle per sample."""

    samples: TrackSamples
    hertz: float

    @property
    def rate_hz(self) -> float:
        if not self.samples.rate_hz:
            raise CommissioningError("the rate of the samples is not known: --rate")
        return self.samples.rate_hz

    @property
    def tracks(self) -> TracksAtSpeed:
        one = self.samples
        return TracksAtSpeed(one.sine, one.cosine, self.rate_hz, self.hertz, one.time_s)

    def split(self) -> tuple[SpeedSamples, SpeedSamples]:
        at = round((1.0 - HELD_OUT) * len(self.samples))
        first, last = self.samples.between(0, at), self.samples.between(at, len(self.samples))
        return replace(self, samples=first), replace(self, samples=last)


@dataclass(frozen=True)
class InForce:
    """What a module computes with: table, conditioning and the corners of the low-passes."""

    correction: Correction
    corners: Corners = NO_LOW_PASS

    def added_cycles(self, hertz: float) -> float:
        """What it adds to the position at this speed for 2002:07."""
        conditioning = self.correction.conditioning
        if not conditioning.delay_s:
            return 0.0
        front = FrontEnd(conditioning, self.corners)
        front.use_interval(1.0)
        return front.lag_intervals(hertz) * hertz


@dataclass(frozen=True, eq=False)
class ErrorAtSpeed:
    """Errors of the position at one speed, cycles; ``before`` is None where the position was lost then.

    before, after             rms about the mean
    mean_before, mean_after   the mean, by the delay that the amplitude tells
    """

    hertz: float
    before: float | None
    after: float
    mean_before: float | None
    mean_after: float
    deviation: Deviation


def errors_at(
    measured: SpeedSamples,
    before: InForce,
    after: InForce,
    path: PathFit,
    block_samples: int,
    adc_bits: int | None,
) -> ErrorAtSpeed:
    """Errors of these samples. CalibrationError, with the speed, where they cannot be judged."""
    with naming_speed(measured.hertz):
        record = measured.samples.recording(adc_bits)
        speed = mean_speed(record, measured.hertz / measured.rate_hz)
        old, new = (_phases(measured.samples, used, speed) for used in (before, after))
        deviation = best_of_phases(record, new, new, block_samples)
        hertz = speed * measured.rate_hz
        late = path.low_pass.delay_cycles(hertz)
        mean_after = after.added_cycles(hertz) - late
        rms_before = mean_before = None
        both = np.isfinite(old) & np.isfinite(new)
        if both.mean() > 0.5:
            try:
                rms_before = best_of_phases(record, old, old, block_samples).rms
                mean_before = before.added_cycles(hertz) - late + _mean(old[both] - new[both])
            except CalibrationError:
                rms_before = mean_before = None
        return ErrorAtSpeed(hertz, rms_before, deviation.rms, mean_before, mean_after, deviation)


def _phases(samples: TrackSamples, used: InForce, speed_cycles: float) -> FloatArray:
    config = ChainConfig(corner_hz=used.corners.corner_hz, cosine_corner_hz=used.corners.cosine_corner_hz)
    found = supervise(samples, used.correction, config.chain_limits, speed_cycles).position
    found[:SETTLING_SAMPLES] = math.nan
    return np.asarray(found % 1.0, np.float64)


def _mean(off: FloatArray) -> float:
    around = about_mean(off)
    return float(wrap(np.asarray([np.mean(off - around)]))[0] + np.mean(around))
