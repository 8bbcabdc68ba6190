"""Drift of an encoder from its active table, and its figures; the module is not changed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from canfb.calibrate.error_over_speed import InForce, SpeedSamples, errors_at
from canfb.calibrate.measurement import Heard, Settings, measure
from canfb.calibrate.own_calibration import ModuleDrift
from canfb.calibration.deviation import Deviation
from canfb.calibration.drift import drift
from canfb.calibration.ellipse import fit_ellipse
from canfb.calibration.over_speeds import measured_at_standstill
from canfb.calibration.path_fit import NO_PATH
from canfb.calibration.result import Calibration
from canfb.master.circumstances import PERCENT, Circumstances, percent, where_words
from canfb.master.samples import TrackSamples
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import Correction
from canfb.tables.table_file import table_words


class EllipseChange(NamedTuple):
    """How the ellipse of the tracks has changed since the active conditioning was measured, at standstill.

    sine_offset, cosine_offset   relative to the amplitude
    gain                         amplitude of the cosine to that of the sine, relative
    phase_rad                    deviation of the tracks from a right angle
    """

    sine_offset: float
    cosine_offset: float
    gain: float
    phase_rad: float


@dataclass(frozen=True, eq=False)
class DriftCheck:
    """What the active table gets wrong now, cycles.

    rms, peak     of the error over the cycle, its constant part taken off
    on_samples    deviation of the samples; its ``before`` is that with the active table
    change        None where the active conditioning is none
    """

    rms: float
    peak: float
    active: Correction
    calibration: Calibration
    on_samples: Deviation
    change: EllipseChange | None = None

    @property
    def seen(self) -> bool:
        """False if it is no more than the uncertainty of the measurement."""
        return self.rms > 2.0 * self.calibration.uncertainty_rms


def check(samples: TrackSamples, active: Correction, settings: Settings, heard: Heard) -> DriftCheck:
    """Measure again, with the active conditioning, and compare. Errors as for a calibration."""
    measured = measure(samples, settings, active, heard, active.conditioning)
    return _compared(measured.calibration, active, measured.on_samples)


def check_at_speed(measured: SpeedSamples, active: InForce, settings: Settings, heard: Heard) -> DriftCheck:
    """:func:`check` of samples as they came, at any speed: the analog path that is active is taken out."""
    used = active.correction
    heard(0.1)
    found = measured_at_standstill(
        measured.tracks,
        used.conditioning.cosine_delay_s,
        active.corners,
        adc_bits=settings.adc_bits,
        entries=settings.entries,
    )
    heard(0.8)
    now = InForce(found.correction, active.corners)
    errors = errors_at(measured, active, now, NO_PATH, found.block_samples, settings.adc_bits)
    before = errors.after if errors.before is None else errors.before
    return _compared(found, used, replace(errors.deviation, before_rms=before))


def _compared(fresh: Calibration, active: Correction, on_samples: Deviation) -> DriftCheck:
    found = drift(fresh, active.table, active.conditioning)
    return DriftCheck(found.rms, found.peak, active, fresh, on_samples, _change(fresh, active.conditioning))


def _change(fresh: Calibration, active: Conditioning) -> EllipseChange | None:
    if fresh.tracks is None or (active.sine_gain == active.cosine_gain == 1.0 and not active.phase_error_rad):
        return None
    now = fit_ellipse(*fresh.tracks)
    s, c = now.apply(*fresh.tracks)
    amplitude = float((s * s + c * c).mean() ** 0.5)
    return EllipseChange(
        (now.sine_offset_counts - active.sine_offset_counts) * now.sine_gain / amplitude,
        (now.cosine_offset_counts - active.cosine_offset_counts) * now.cosine_gain / amplitude,
        (now.sine_gain / now.cosine_gain) / (active.sine_gain / active.cosine_gain) - 1.0,
        now.phase_error_rad - active.phase_error_rad,
    )


def module_drift_lines(found: ModuleDrift, active: Correction, where: Circumstances) -> list[str]:
    """The check by the module itself, as text."""
    return [
        f"{'active table':24}{table_words(active)}",
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
        f"{'active table':24}{table_words(found.active)}",
        f"{'its error now, rms':24}{percent(found.rms, where)} of a cycle",
        f"{'its error now, peak':24}{percent(found.peak, where)} of a cycle",
        f"{'uncertainty, peak':24}{percent(found.calibration.uncertainty_peak, where)} of a cycle",
        f"{'deviation of samples':24}{percent(found.on_samples.before_rms, where)} rms now, "
        f"{percent(found.calibration.residual_rms, where)} with a new table",
    ]
    if found.change is not None:
        change, part = found.change, PERCENT
        lines.append(
            f"{'changed since':24}offset {part * change.sine_offset:+.2g} / "
            f"{part * change.cosine_offset:+.2g} % of the amplitude, gain of the cosine "
            f"{part * change.gain:+.2g} %, phase {change.phase_rad:+.2g} rad"
        )
    if not found.seen:
        lines.append("no drift within the uncertainty of this measurement")
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
        "changed": None if found.change is None else found.change._asdict(),
    }
