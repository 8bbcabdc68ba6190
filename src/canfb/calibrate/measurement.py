"""A reference measurement: from samples to a table, compared with the previous one.

The samples are processed by the chain of the module, without the module, which gives the flags of the
supervision and the error of the position at each speed. Its rms is the deviation from smooth motion; its
mean is the delay by the amplitude (:mod:`canfb.calibration.path_fit`), less the correction for 2002:07.
Several speeds also give the analog path for the module.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from canfb.calibration.deviation import Deviation, best_deviation, best_of_phases
from canfb.calibration.ellipse import fit_ellipse, without_harmonics
from canfb.calibration.methods import calibrate_from_motion, calibrate_from_zero_crossings
from canfb.calibration.over_speeds import (
    SpeedCalibration,
    TracksAtSpeed,
    calibrate_over_speeds,
    mean_speed,
    measured_at_standstill,
)
from canfb.calibration.path_fit import NO_PATH, PathFit
from canfb.calibration.result import Calibration, Method, Reason, about_mean, naming_speed
from canfb.errors import CalibrationError, saying
from canfb.master.access import CommissioningError, Progress, as_real32
from canfb.master.samples import TrackSamples
from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import ChainConfig, ChainLimits
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import Correction
from canfb.signal.front_end import NO_LOW_PASS, Corners, FrontEnd
from canfb.signal.phase import BoolArray, FloatArray, IntArray, wrap
from canfb.signal.sample import TICK_S, TICKS, Sample
from canfb.signal.supervision import AMPLITUDE, CLIPPED, FROZEN, LOST, RESIDUAL, VALID

# Faults that the chain can detect in samples alone, and their bits of the status word.
FLAGS = {"residual": RESIDUAL, "amplitude": AMPLITUDE, "clipped": CLIPPED, "frozen": FROZEN, "lost": LOST}
FEEDBACK = np.dtype([("status", np.int64), ("cycles", np.int64), ("phase", float), ("amplitude", float)])


@dataclass(frozen=True, eq=False)
class SupervisedSamples:
    """Results of the chain for each sample: arrays of one length.

    position     cycles since the first sample, NaN: not valid
    amplitude    counts, after conditioning; NaN: no sample
    status       status word, 2011:01
    elapsed      sampling intervals since the previous sample, 1 without sample times
    """

    position: FloatArray
    amplitude: FloatArray
    status: IntArray
    elapsed: FloatArray

    @property
    def valid(self) -> BoolArray:
        return np.isfinite(self.position)

    @property
    def flagged(self) -> dict[str, int]:
        """Number of samples with each of :data:`FLAGS`, if not zero."""
        counts = {name: int(np.count_nonzero(self.status & bit)) for name, bit in FLAGS.items()}
        return {name: count for name, count in counts.items() if count}

    @property
    def speed(self) -> FloatArray:
        """Cycles per sampling interval at each sample but the first, NaN where it is not known."""
        return np.asarray(np.diff(self.position) / self.elapsed[1:], np.float64)


def supervise(
    samples: TrackSamples, used: Correction, limits: ChainLimits, speed_cycles: float
) -> SupervisedSamples:
    """Process the samples by the chain as a module with these limits does.

    ``speed_cycles`` is the speed at the first sample, cycles per interval, error below 0.5. The
    samples must have a rate.
    """
    chain = SignalChain(ChainConfig())
    chain.set_limits(limits)
    chain.activate(used)
    if samples.rate_hz:
        chain.sync_interval_s = 1.0 / samples.rate_hz
    chain.restart(0, speed_cycles)
    missed = np.isnan(samples.sine) | np.isnan(samples.cosine)
    ticks = [] if samples.time_s is None else np.rint(samples.time_s / TICK_S).tolist()
    stamps = [int(one) % TICKS for one in ticks] or itertools.repeat(None)
    rows = zip(missed.tolist(), samples.sine.tolist(), samples.cosine.tolist(), stamps, strict=False)
    steps = (
        chain.miss() if out else chain.step(Sample(sine, cosine, time_100ns=stamp))
        for out, sine, cosine, stamp in rows
    )
    each = ((one.status, one.cycles, one.phase, one.amplitude) for one in steps)
    found = np.fromiter(each, FEEDBACK, len(samples))
    seen = (found["status"] & VALID > 0) & ~missed
    cycles = found["cycles"] - (found["cycles"][seen][0] if seen.any() else 0)
    elapsed = np.ones(len(samples))
    if samples.time_s is not None and samples.rate_hz:
        elapsed[1:] = np.diff(samples.time_s) * samples.rate_hz
    return SupervisedSamples(
        np.where(seen, cycles + found["phase"], math.nan),
        np.where(missed, math.nan, found["amplitude"]),
        found["status"],
        elapsed,
    )


SETTLING_SAMPLES = 16  # samples until the speed of the chain has settled
HELD_OUT = 0.25  # part of the samples at each speed that is not fitted but used for verification


@dataclass(frozen=True, eq=False)
class SpeedSamples:
    """Samples at a speed: cycles per second, with sign, error below half a cycle per sample."""

    samples: TrackSamples
    hertz: float

    @property
    def rate_hz(self) -> float:
        if not self.samples.rate_hz:
            raise CommissioningError("the rate of the samples is not known: --sample-rate")
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
    """The values a module computes with: table, conditioning and the corners of the low-passes."""

    correction: Correction
    corners: Corners = NO_LOW_PASS

    def added_cycles(self, hertz: float) -> float:
        """The correction of the position for 2002:07 at this speed."""
        conditioning = self.correction.conditioning
        if not conditioning.delay_s:
            return 0.0
        front = FrontEnd(conditioning, self.corners)
        front.use_interval(1.0)
        return front.lag_intervals(hertz) * hertz


@dataclass(frozen=True, eq=False)
class ErrorAtSpeed:
    """Errors of the position at one speed, cycles; ``before`` None: the position was lost.

    before, after             rms about the mean
    mean_before, mean_after   mean, by the delay that follows from the amplitude
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
    """Errors of these samples. CalibrationError, with the speed, if they are inconclusive."""
    with naming_speed(measured.hertz):
        record = measured.samples.recording(adc_bits)
        speed = mean_speed(record, measured.hertz / measured.rate_hz)
        old, new = (_phases(measured.samples, used, speed) for used in (before, after))
        both = np.isfinite(old) & np.isfinite(new)
        known = both.mean() > 0.5
        phase, was = (np.where(both, new, math.nan), old) if known else (new, new)
        deviation = best_of_phases(record, phase, was, block_samples)
        hertz = speed * measured.rate_hz
        late = path.low_pass.delay_cycles(hertz)
        mean_after = after.added_cycles(hertz) - late
        mean_before = before.added_cycles(hertz) - late + _mean(old[both] - new[both]) if known else None
        return ErrorAtSpeed(
            hertz, deviation.before_rms if known else None, deviation.rms, mean_before, mean_after, deviation
        )


def _phases(samples: TrackSamples, used: InForce, speed_cycles: float) -> FloatArray:
    config = ChainConfig(corner_hz=used.corners.corner_hz, cosine_corner_hz=used.corners.cosine_corner_hz)
    found = supervise(samples, used.correction, config.chain_limits, speed_cycles).position
    found[:SETTLING_SAMPLES] = math.nan
    return np.asarray(found % 1.0, np.float64)


def _mean(off: FloatArray) -> float:
    around = about_mean(off)
    return float(wrap(np.asarray([np.mean(off - around)]))[0] + np.mean(around))


MOTION, ZERO_CROSSINGS = "motion", "zero-crossings"
METHODS = {MOTION: calibrate_from_motion, ZERO_CROSSINGS: calibrate_from_zero_crossings}
BLOCK_CYCLES = 4  # length of a block for the method of zero crossings


@dataclass(frozen=True)
class Settings:
    """Settings of a calibration.

    method         "motion" or "zero-crossings"
    conditioning   "fit", or None to leave all to the table
    entries        of the table, 16..4096
    adc_bits       4..16, None: found from the samples
    """

    method: str = MOTION
    conditioning: str | None = "fit"
    entries: int = 1024
    adc_bits: int | None = None


@dataclass(frozen=True, eq=False)
class Measurement:
    """A reference measurement, compared with the previous correction.

    samples       samples used
    calibration   result
    before        previous correction
    on_samples    deviation of the samples, with the new and the previous correction
    over_speeds   result of several speeds; all others are then of the lowest one, at standstill
    """

    samples: TrackSamples
    calibration: Calibration
    before: Correction
    on_samples: Deviation
    over_speeds: OverSpeeds | None = None

    @property
    def found(self) -> Correction:
        return self.calibration.correction


def measure(
    samples: TrackSamples,
    settings: Settings,
    before: Correction,
    progress: Progress,
    conditioning: Conditioning | None = None,
) -> Measurement:
    """Calibrate; ``conditioning`` takes precedence over ``settings.conditioning``.

    The tracks of ``samples`` must be simultaneous (:meth:`TrackSamples.together`). The delays of ``before``
    are kept: one speed does not determine them.
    CalibrationError for unusable samples, CommissioningError for wrong settings.
    """
    if before.conditioning.cosine_delay_s and settings.conditioning is None:
        raise CommissioningError(
            "2002:06 is set, and the delay between the tracks is removed behind offset and gain: "
            "--conditioning fit"
        )
    with saying(CommissioningError, "the samples cannot be used", ValueError):
        calibration = METHODS[settings.method](
            samples.sine,
            samples.cosine,
            settings.conditioning if conditioning is None else conditioning,
            time_s=samples.time_s,
            adc_bits=settings.adc_bits,
            entries=settings.entries,
            progress=progress,
        )
    kept = calibration.conditioning.with_delays_of(before.conditioning)
    if samples.at_speed and conditioning is None:
        kept = without_harmonics(kept)
    calibration = replace(calibration, conditioning=kept)
    on_samples = best_deviation(
        samples.recording(settings.adc_bits), calibration.correction, before, block_of(calibration)
    )
    return Measurement(samples, calibration, before, on_samples)


def block_of(calibration: Calibration) -> int:
    if calibration.method == Method.MOTION:
        return calibration.block_samples
    return BLOCK_CYCLES * calibration.block_samples


ESTIMATE = "estimate"
FIT_PART = 0.8
WORSE = 1.5  # largest ratio of the errors after and before, at any speed, that noise explains


@dataclass(frozen=True, eq=False)
class OverSpeeds:
    """Results of several speeds.

    path        the analog path
    before      previously in force
    after       to be put in force
    errors      at each speed, of samples that were not fitted
    """

    path: PathFit
    before: InForce
    after: InForce
    errors: tuple[ErrorAtSpeed, ...]

    @property
    def peak_cycles(self) -> float:
        return max(one.deviation.peak for one in self.errors)

    def near(self, hertz: float) -> ErrorAtSpeed:
        return min(self.errors, key=lambda one: abs(one.hertz - hertz))


def measure_speeds(
    samples: Sequence[SpeedSamples],
    settings: Settings,
    before: InForce,
    progress: Progress,
    delay: str | float | None = None,
) -> Measurement:
    """Calibrate. ``delay`` is 2002:07 in seconds, or :data:`ESTIMATE`; None: as ``before``.

    CalibrationError for unusable samples, CommissioningError for wrong settings.
    """
    parts = [one.split() for one in samples]
    found = calibrate_over_speeds(
        [fit.tracks for fit, _ in parts],
        adc_bits=settings.adc_bits,
        entries=settings.entries,
        progress=lambda part: progress(FIT_PART * part),
    )
    found = found.with_delay(_delay(found, delay, before))
    corners = Corners(*map(as_real32, (found.path.corners.corner_hz, found.path.corners.cosine_corner_hz)))
    after = InForce(found.calibration.correction, corners)
    block, bits = found.calibration.block_samples, settings.adc_bits
    each = [errors_at(held, before, after, found.path, block, bits) for _, held in parts]
    errors = tuple(sorted(each, key=lambda one: one.hertz))
    progress(1.0)
    for one in errors:
        if one.before is not None and one.after > WORSE * one.before:
            raise CalibrationError(
                f"at {one.hertz:.6g} cycles/s the error would rise from {one.before:.2g} to {one.after:.2g} "
                "cycle rms: the analog path does not follow this model",
                Reason.SPEED,
            )
    over = OverSpeeds(found.path, before, after, errors)
    lowest = min(samples, key=lambda one: abs(one.hertz))
    return Measurement(lowest.samples, found.calibration, before.correction, over.near(0.0).deviation, over)


def _delay(found: SpeedCalibration, delay: str | float | None, before: InForce) -> float:
    if delay is None:
        return before.correction.conditioning.delay_s
    if not isinstance(delay, str):
        return delay
    low_pass = found.path.low_pass
    if not low_pass.is_detected:
        raise CalibrationError(
            "the amplitude does not fall with the speed, so no delay can be estimated from it: give --delay "
            "SECONDS from the data sheets, or leave --delay out",
            Reason.SPEED,
        )
    return low_pass.delay_s


def check_at_speed(
    measured: SpeedSamples, active: InForce, settings: Settings, progress: Progress
) -> Measurement:
    """Measurement from raw samples at any speed, with the active analog path removed."""
    used = active.correction
    progress(0.1)
    found = measured_at_standstill(
        measured.tracks,
        used.conditioning.cosine_delay_s,
        active.corners,
        adc_bits=settings.adc_bits,
        entries=settings.entries,
    )
    progress(0.8)
    now = InForce(found.correction, active.corners)
    errors = errors_at(measured, active, now, NO_PATH, found.block_samples, settings.adc_bits)
    return Measurement(measured.samples, found, used, errors.deviation)


def conditioning_change(fresh: Calibration, active: Conditioning) -> dict[str, float] | None:
    """Change of the conditioning; None if ``active`` has neither gains nor phase error."""
    if active.sine_gain == active.cosine_gain == 1.0 and not active.phase_error_rad:
        return None
    now = fit_ellipse(*fresh.tracks)
    s, c = now.apply(*fresh.tracks)
    amplitude = float((s * s + c * c).mean() ** 0.5)
    return {
        "sine_offset": (now.sine_offset_counts - active.sine_offset_counts) * now.sine_gain / amplitude,
        "cosine_offset": (now.cosine_offset_counts - active.cosine_offset_counts)
        * now.cosine_gain
        / amplitude,
        "gain": (now.sine_gain / now.cosine_gain) / (active.sine_gain / active.cosine_gain) - 1.0,
        "phase_rad": now.phase_error_rad - active.phase_error_rad,
    }
