"""Drift of an encoder from its active table; the module is not changed."""

from __future__ import annotations

from dataclasses import dataclass

from canfb.calibration.deviation import Deviation
from canfb.calibration.drift import drift
from canfb.calibration.result import Calibration
from canfb.commissioning.measurement import Heard, Settings, measure
from canfb.commissioning.samples import TrackSamples
from canfb.signal.correction import Correction


@dataclass(frozen=True, eq=False)
class DriftCheck:
    """What the active table gets wrong now, cycles.

    rms, peak     of the error over the cycle, its constant part taken off
    on_samples    deviation of the samples; its ``before`` is that with the active table
    """

    rms: float
    peak: float
    active: Correction
    calibration: Calibration
    on_samples: Deviation

    @property
    def seen(self) -> bool:
        """False if it is no more than the uncertainty of the measurement."""
        return self.rms > 2.0 * self.calibration.uncertainty_rms


def check(samples: TrackSamples, active: Correction, settings: Settings, heard: Heard) -> DriftCheck:
    """Measure again, with the active conditioning, and compare. Errors as for a calibration."""
    measured = measure(samples, settings, active, heard, active.conditioning)
    found = drift(measured.calibration, active.table, active.conditioning)
    return DriftCheck(found.rms, found.peak, active, measured.calibration, measured.on_samples)
