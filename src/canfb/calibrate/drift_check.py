"""Drift of an encoder from its active table, and its figures; the module is not changed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

from canfb.calibrate.calibration_summary import CalibrateResult
from canfb.calibrate.measurement import Settings, measure
from canfb.calibrate.own_calibration import ModuleDrift
from canfb.calibrate.samples_through_chain import InForce, SpeedSamples, errors_at
from canfb.calibration.deviation import Deviation, drift
from canfb.calibration.ellipse import fit_ellipse
from canfb.calibration.over_speeds import measured_at_standstill
from canfb.calibration.path_fit import NO_PATH
from canfb.calibration.result import Calibration
from canfb.master.access import Progress
from canfb.master.machine_watch import PERCENT, Provenance, percent, where_words
from canfb.master.samples import TrackSamples
from canfb.rows import Row, as_figures, as_lines
from canfb.sdo.table_file import table_words
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import Correction


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
    def is_significant(self) -> bool:
        """False if it is no more than the uncertainty of the measurement."""
        return self.rms > 2.0 * self.calibration.uncertainty_rms


def check(samples: TrackSamples, active: Correction, settings: Settings, progress: Progress) -> DriftCheck:
    """Measure again, with the active conditioning, and compare. Errors as for a calibration."""
    measured = measure(samples, settings, active, progress, active.conditioning)
    return _compared(measured.calibration, active, measured.on_samples)


def check_at_speed(
    measured: SpeedSamples, active: InForce, settings: Settings, progress: Progress
) -> DriftCheck:
    """:func:`check` of samples as they came, at any speed: the analog path that is active is taken out."""
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


def module_drift_result(found: ModuleDrift, active: Correction, where: Provenance) -> CalibrateResult:
    """The check by the module itself; cycles."""
    rows = [
        Row(**where_words(where)),
        *_error_rows(found.rms, found.peak, active, where),
        Row(
            "noise of a sample",
            f"{percent(found.residual_rms, where)} rms",
            new_table_rms_cycles=found.residual_rms,
        ),
        Row("coverage", f"{PERCENT * found.coverage:.0f} %", coverage=found.coverage),
    ]
    return CalibrateResult(as_figures(rows), as_lines(rows))


def drift_result(found: DriftCheck, where: Provenance) -> CalibrateResult:
    """The check from samples; cycles."""
    fresh, change = found.calibration, found.change
    now_rms, new_rms = found.on_samples.before_rms, fresh.residual_rms
    changed = change and (
        f"offset {PERCENT * change.sine_offset:+.2g} / {PERCENT * change.cosine_offset:+.2g} % of the "
        f"amplitude, gain of the cosine {PERCENT * change.gain:+.2g} %, phase {change.phase_rad:+.2g} rad"
    )
    rows = [
        Row(**where_words(where)),
        *_error_rows(found.rms, found.peak, found.active, where),
        Row(
            "uncertainty, peak",
            f"{percent(fresh.uncertainty_peak, where)} of a cycle",
            uncertainty_rms_cycles=fresh.uncertainty_rms,
            uncertainty_peak_cycles=fresh.uncertainty_peak,
        ),
        Row(
            "deviation of samples",
            f"{percent(now_rms, where)} rms now, {percent(new_rms, where)} with a new table",
            active_rms_cycles=now_rms,
            new_table_rms_cycles=new_rms,
        ),
        Row("changed since", changed, changed=change and change._asdict()),
        Row(drift_seen=found.is_significant, coverage=fresh.coverage, samples=fresh.samples_used),
    ]
    nothing = [] if found.is_significant else ["no drift within the uncertainty of this measurement"]
    return CalibrateResult(as_figures(rows), [*as_lines(rows), *nothing])


def _error_rows(rms: float, peak: float, active: Correction, where: Provenance) -> list[Row]:
    return [
        Row("active table", table_words(active), crc32=f"{active.crc32:08X}"),
        Row("its error now, rms", f"{percent(rms, where)} of a cycle", drift_rms_cycles=rms),
        Row("its error now, peak", f"{percent(peak, where)} of a cycle", drift_peak_cycles=peak),
    ]
