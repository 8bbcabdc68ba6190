"""A reference measurement at several speeds: samples in, and what the module is to compute with out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from canfb.calibration.over_speeds import SpeedCalibration, calibrate_over_speeds
from canfb.calibration.path_fit import LowPass, PathFit
from canfb.calibration.result import Reason
from canfb.commissioning.error_over_speed import ErrorAtSpeed, InForce, SpeedSamples, errors_over_speed
from canfb.commissioning.measurement import Heard, Measurement, Settings
from canfb.commissioning.supervision_limits import as_real32
from canfb.errors import CalibrationError
from canfb.signal.harmonics import Corners

ESTIMATE = "estimate"
FIT_PART = 0.8
WORSE = 1.5  # than before, at any speed: noise, and no more


@dataclass(frozen=True, eq=False)
class OverSpeeds:
    """What is known beyond one speed.

    samples     all of them, with their speeds
    path        the analog path
    before      what was in force
    after       what is to be
    errors      at each speed, of samples that were held out
    """

    samples: tuple[SpeedSamples, ...]
    path: PathFit
    before: InForce
    after: InForce
    errors: tuple[ErrorAtSpeed, ...]

    @property
    def low_pass(self) -> LowPass:
        """That of the sine, which the position is late by."""
        return self.path.low_pass

    @property
    def delay_s(self) -> float:
        """2002:07 as it is to be."""
        return self.after.correction.conditioning.delay_s

    @property
    def peak_cycles(self) -> float:
        """The largest error about the mean, at any speed."""
        return max(one.deviation.peak for one in self.errors)

    def near(self, hertz: float) -> ErrorAtSpeed:
        """The error at the speed that is nearest to this one."""
        return min(self.errors, key=lambda one: abs(one.hertz - hertz))


@dataclass(frozen=True, eq=False)
class SpeedMeasurement(Measurement):
    """A measurement at the lowest speed, as it is at standstill, and what the others say."""

    over_speeds: OverSpeeds


def measure_speeds(
    samples: Sequence[SpeedSamples],
    settings: Settings,
    before: InForce,
    heard: Heard,
    delay: str | float | None = None,
) -> SpeedMeasurement:
    """Calibrate. ``delay`` is 2002:07 in seconds, or :data:`ESTIMATE`; None: as it is ``before``.

    CalibrationError for samples that cannot be used, CommissioningError for wrong settings.
    """
    parts = [one.split() for one in samples]
    found = calibrate_over_speeds(
        [fit.tracks for fit, _ in parts],
        adc_bits=settings.adc_bits,
        entries=settings.entries,
        progress=lambda part: heard(FIT_PART * part),
    )
    found = found.with_delay(_delay(found, delay, before))
    corners = Corners(*map(as_real32, (found.path.corners.corner_hz, found.path.corners.cosine_corner_hz)))
    after = InForce(found.correction, corners)
    errors = errors_over_speed(
        [held for _, held in parts],
        before,
        after,
        found.path,
        found.calibration.block_samples,
        settings.adc_bits,
    )
    heard(1.0)
    _check_better(errors)
    over = OverSpeeds(tuple(samples), found.path, before, after, errors)
    lowest = min(samples, key=lambda one: abs(one.hertz))
    on_samples = min(errors, key=lambda one: abs(one.hertz))
    deviation = on_samples.deviation
    if on_samples.before is not None:
        deviation = replace(deviation, before_rms=on_samples.before)
    return SpeedMeasurement(lowest.samples, found.calibration, before.correction, deviation, over)


def _delay(found: SpeedCalibration, delay: str | float | None, before: InForce) -> float:
    if delay is None:
        return before.correction.conditioning.delay_s
    if not isinstance(delay, str):
        return delay
    low_pass = found.path.low_pass
    if not low_pass.is_seen:
        raise CalibrationError(
            "the amplitude does not fall with the speed, so it tells no delay: --delay SECONDS with that of "
            "the data sheets, or without --delay",
            Reason.SPEED,
        )
    return low_pass.delay_s


def _check_better(errors: Sequence[ErrorAtSpeed]) -> None:
    for one in errors:
        if one.before is not None and one.after > WORSE * one.before:
            raise CalibrationError(
                f"at {one.hertz:.6g} cycles/s the error would rise from {one.before:.2g} to {one.after:.2g} "
                "cycle rms: the analog path is not the one of this model",
                Reason.SPEED,
            )
