"""How far the position is off at each speed, as the module computes it, before and after a calibration.

The samples go through the chain of the module with the one set and with the other. What a smooth motion does
not explain is the error within a cycle. Its mean does not show against the samples themselves: it is the
delay that the amplitude tells (:mod:`canfb.calibration.path_fit`), less what the module adds for 2002:07.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from canfb.calibrate.supervised_samples import supervise
from canfb.calibration.analog_path import mean_speed
from canfb.calibration.deviation import Deviation, best_of_phases
from canfb.calibration.figures import about_mean
from canfb.calibration.over_speeds import TracksAtSpeed
from canfb.calibration.path_fit import PathFit
from canfb.errors import CalibrationError
from canfb.master.access import CommissioningError
from canfb.master.samples import TrackSamples
from canfb.signal.chain_config import ChainConfig
from canfb.signal.correction import Correction
from canfb.signal.front_end import FrontEnd
from canfb.signal.harmonics import NO_LOW_PASS, Corners
from canfb.signal.phase import FloatArray, wrap

SETTLING_SAMPLES = 16  # until the chain knows the speed well
HELD_OUT = 0.25  # of the samples at each speed: not for the fit


@dataclass(frozen=True, eq=False)
class SpeedSamples:
    """Samples at a speed: cycles per second, with sign, right to half a cycle per sample."""

    samples: TrackSamples
    hertz: float

    @property
    def rate_hz(self) -> float:
        """Of the samples. CommissioningError where it is not known."""
        if not self.samples.rate_hz:
            raise CommissioningError("the rate of the samples is not known: --rate")
        return self.samples.rate_hz

    @property
    def tracks(self) -> TracksAtSpeed:
        """For :mod:`canfb.calibration.over_speeds`."""
        one = self.samples
        return TracksAtSpeed(one.sine, one.cosine, self.rate_hz, self.hertz, one.time_s)

    def split(self) -> tuple[SpeedSamples, SpeedSamples]:
        """Those for the fit, and those held out, which come after them."""
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
    try:
        return _errors_at(measured, before, after, path, block_samples, adc_bits)
    except CalibrationError as error:
        raise CalibrationError(f"at {measured.hertz:.6g} cycles/s: {error}", error.reason) from error


def _errors_at(
    measured: SpeedSamples,
    before: InForce,
    after: InForce,
    path: PathFit,
    block_samples: int,
    adc_bits: int | None,
) -> ErrorAtSpeed:
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


def errors_over_speed(
    measured: Sequence[SpeedSamples],
    before: InForce,
    after: InForce,
    path: PathFit,
    block_samples: int,
    adc_bits: int | None,
) -> tuple[ErrorAtSpeed, ...]:
    """:func:`errors_at` for each of them, from the lowest speed on."""
    found = [errors_at(one, before, after, path, block_samples, adc_bits) for one in measured]
    return tuple(sorted(found, key=lambda one: one.hertz))


def _phases(samples: TrackSamples, used: InForce, speed_cycles: float) -> FloatArray:
    """Of the samples as the module computes them, cycles; NaN where it has none."""
    config = ChainConfig(corner_hz=used.corners.corner_hz, cosine_corner_hz=used.corners.cosine_corner_hz)
    found = supervise(samples, used.correction, config.chain_limits, speed_cycles).position
    found[:SETTLING_SAMPLES] = math.nan
    return np.asarray(found % 1.0, np.float64)


def _mean(off: FloatArray) -> float:
    """Of differences of phases, cycles."""
    around = about_mean(off)
    return float(wrap(np.asarray([np.mean(off - around)]))[0] + np.mean(around))
