"""A reference measurement: samples in, a table out, and how much better it is than the one before."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from canfb.calibration.deviation import Deviation, best_deviation
from canfb.calibration.from_motion import calibrate_from_motion
from canfb.calibration.result import Calibration, Method
from canfb.calibration.track_harmonics import without_harmonics
from canfb.calibration.zero_crossing import calibrate_from_zero_crossings
from canfb.commissioning.access import CommissioningError
from canfb.commissioning.samples import TrackSamples
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import Correction

MOTION, ZERO_CROSSINGS = "motion", "zero-crossings"
METHODS = {MOTION: calibrate_from_motion, ZERO_CROSSINGS: calibrate_from_zero_crossings}
BLOCK_CYCLES = 4  # of the method of zero crossings
Heard = Callable[[float], None]


@dataclass(frozen=True)
class Settings:
    """How to calibrate.

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
    """A reference measurement, compared with what was active before.

    samples       what it was made of
    calibration   what it gave
    before        what was active
    on_samples    deviation of those samples, with the new and with the old set
    """

    samples: TrackSamples
    calibration: Calibration
    before: Correction
    on_samples: Deviation

    @property
    def found(self) -> Correction:
        """Table and conditioning that were found."""
        return self.calibration.correction


def measure(
    samples: TrackSamples,
    settings: Settings,
    before: Correction,
    heard: Heard,
    conditioning: Conditioning | None = None,
) -> Measurement:
    """Calibrate; with a ``conditioning``, with this one in place of what the settings say.

    The tracks of ``samples`` are sampled at once (:meth:`TrackSamples.together`). The delays of ``before``
    stay: they are not to be seen at one speed.
    CalibrationError for samples that cannot be used, CommissioningError for wrong settings.
    """
    if before.conditioning.cosine_delay_s and settings.conditioning is None:
        raise CommissioningError(
            "2002:06 is set, and the delay between the tracks is removed behind offset and gain: "
            "--conditioning fit"
        )
    try:
        calibration = METHODS[settings.method](
            samples.sine,
            samples.cosine,
            settings.conditioning if conditioning is None else conditioning,
            time_s=samples.time_s,
            adc_bits=settings.adc_bits,
            entries=settings.entries,
            progress=heard,
        )
    except ValueError as error:
        raise CommissioningError(f"the samples cannot be used: {error}") from error
    kept = calibration.conditioning.with_delays_of(before.conditioning)
    if samples.at_speed and conditioning is None:
        kept = without_harmonics(kept)
    calibration = replace(calibration, conditioning=kept)
    found = calibration.correction
    block = block_of(calibration)
    on_samples = best_deviation(samples.recording(settings.adc_bits), found, before, block)
    return Measurement(samples, calibration, before, on_samples)


def block_of(calibration: Calibration) -> int:
    """Samples over which to take the motion for smooth."""
    if calibration.method == Method.MOTION:
        return calibration.block_samples
    return BLOCK_CYCLES * calibration.block_samples
