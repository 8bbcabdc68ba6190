"""How far an encoder has moved away from the table that is in force: measured, not touched."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from canfb.calibration.drift import drift
from canfb.calibration.result import Calibration
from canfb.commissioning.deviation import Deviation
from canfb.commissioning.own_calibration import ModuleDrift
from canfb.commissioning.procedure import Heard, Settings, measure
from canfb.commissioning.samples import TrackSamples
from canfb.commissioning.summary import Circumstances, percent, table_words, where_words
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
    """Measure again, with the conditioning in force, and compare. Errors as for a calibration."""
    measured = measure(samples, settings, active, heard, active.conditioning)
    found = drift(measured.calibration, active.table, active.conditioning)
    return DriftCheck(found.rms, found.peak, active, measured.calibration, measured.on_samples)


def module_drift_lines(found: ModuleDrift, active: Correction, where: Circumstances) -> list[str]:
    """What the module itself says, for people."""
    return [
        f"{'table in force':24}{table_words(active)}",
        f"{'its error now, rms':24}{percent(found.rms, where)} of a cycle",
        f"{'its error now, peak':24}{percent(found.peak, where)} of a cycle",
        f"{'noise of a sample':24}{percent(found.residual_rms, where)} rms",
        f"{'coverage':24}{100 * found.coverage:.0f} %",
    ]


def module_drift_json(found: ModuleDrift, active: Correction, where: Circumstances) -> dict[str, Any]:
    """The same for programs; cycles."""
    return {
        **where_words(where),
        "crc32": f"{active.crc32:08X}",
        "drift_rms_cycles": found.rms,
        "drift_peak_cycles": found.peak,
        "new_table_rms_cycles": found.residual_rms,
        "coverage": found.coverage,
    }


def drift_lines(found: DriftCheck, where: Circumstances) -> list[str]:
    """For people."""
    lines = [
        f"{'table in force':24}{table_words(found.active)}",
        f"{'its error now, rms':24}{percent(found.rms, where)} of a cycle",
        f"{'its error now, peak':24}{percent(found.peak, where)} of a cycle",
        f"{'measured to':24}{percent(found.calibration.uncertainty_peak, where)} of a cycle",
        f"{'deviation of samples':24}{percent(found.on_samples.before_rms, where)} rms now, "
        f"{percent(found.calibration.residual_rms, where)} with a new table",
    ]
    if not found.seen:
        lines.append("the encoder has not moved away from its table, as far as this measurement can tell")
    return lines


def drift_json(found: DriftCheck, where: Circumstances) -> dict[str, Any]:
    """For programs; cycles."""
    return {
        **where_words(where),
        "crc32": f"{found.active.crc32:08X}",
        "drift_rms_cycles": found.rms,
        "drift_peak_cycles": found.peak,
        "drift_seen": found.seen,
        "uncertainty_rms_cycles": found.calibration.uncertainty_rms,
        "uncertainty_peak_cycles": found.calibration.uncertainty_peak,
        "active_rms_cycles": found.on_samples.before_rms,
        "new_table_rms_cycles": found.calibration.residual_rms,
        "coverage": found.calibration.coverage,
        "samples": found.calibration.samples_used,
    }
