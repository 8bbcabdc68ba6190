"""The figures of a reference measurement: for the terminal, the report and programs.

For several speeds also the analog path, and the error at each speed.
"""

from __future__ import annotations

import math

from canfb.calibrate.measurement import Measurement, OverSpeeds, conditioning_change
from canfb.calibrate.procedure import Installation
from canfb.calibration.path_fit import LowPass
from canfb.calibration.result import Calibration, drift
from canfb.master.machine_watch import LOST, PERCENT, Provenance, percent, where_words
from canfb.master.samples import TrackSamples
from canfb.rows import Findings, Result, Row, Section, as_figures, as_lines
from canfb.sdo.tables import conditioning_in_words, conditioning_words, table_words
from canfb.signal.correction import Correction

SAME_DELAY = 1e-3  # delays are equal within this, relative, which includes rounding to REAL32


def speed_words(hertz: float, where: Provenance) -> str:
    if not where.cycles_per_revolution:
        return f"{hertz:.6g} cycles/s"
    return f"{60.0 * hertz / where.cycles_per_revolution:.4g} rpm"


def speed_rows(over: OverSpeeds, where: Provenance) -> list[Row]:
    """Error at each speed: rms before and after, then the mean."""
    errors = over.errors
    rms = [(one.hertz, "rms", one.before, one.after) for one in errors]
    mean = [(one.hertz, "mean", one.mean_before, one.mean_after) for one in errors]
    figures = [
        {
            "cycles_per_s": one.hertz,
            "before_rms_cycles": one.before,
            "after_rms_cycles": one.after,
            "before_mean_cycles": one.mean_before,
            "after_mean_cycles": one.mean_after,
            "held_out_samples": len(one.deviation.error),
        }
        for one in errors
    ]
    return [
        Row(speeds=figures),
        *(
            Row(
                f"{speed_words(hertz, where)}, {what}",
                LOST if before is None else percent(before, where),
                percent(after, where),
            )
            for hertz, what, before, after in (*rms, *mean)
        ),
    ]


def path_rows(over: OverSpeeds, where: Provenance) -> list[Row]:
    path, low_pass, corners = over.path, over.path.low_pass, over.after.corners
    seen, sigma_s = low_pass.is_detected, low_pass.delay_sigma_s
    sigma = f"± {path.cosine_delay_sigma_s * 1e9:.2g} ns"
    between = (
        f"{path.cosine_delay_s * 1e9:.4g} {sigma} (2002:06)" if path.cosine_delay_s else f"none; {sigma}"
    )
    return [
        Row(
            "cosine after the sine",
            between,
            cosine_delay_s=path.cosine_delay_s,
            cosine_delay_uncertainty_s=path.cosine_delay_sigma_s,
        ),
        Row(
            "low-pass",
            _low_pass_words(over, where),
            corner_hz=corners.corner_hz,
            corner_uncertainty_hz=low_pass.corner_sigma_hz if seen else None,
            cosine_corner_hz=corners.cosine_corner_hz,
            amplitude_left=low_pass.left,
        ),
        Row(
            "delay, by amplitude",
            delay_words(low_pass, where),
            delay_estimate_s=low_pass.delay_s if seen else None,
            delay_estimate_uncertainty_s=sigma_s if math.isfinite(sigma_s) else None,
            delay_estimate_two_poles_s=low_pass.two_poles_delay_s,
            delay_estimate_one_pole=low_pass.is_one_pole and low_pass.checked,
        ),
        Row("delay, 2002:07", delay_set_words(over), delay_s=over.after.correction.conditioning.delay_s),
    ]


def delay_words(low_pass: LowPass, where: Provenance) -> str:
    at = speed_words(low_pass.top_hz, where)
    if low_pass.rises:
        return "not known: the amplitude rises with the speed"
    if not low_pass.is_detected:
        if not math.isfinite(low_pass.delay_sigma_s):
            return "not known: all measured speeds are equal in size"
        return (
            f"none detected up to {at}; one pole would delay by less than "
            f"{low_pass.delay_sigma_s * 1e6:.2g} µs. A delay of the converter does not show"
        )
    words = (
        f"{low_pass.delay_s * 1e6:.4g} ± {low_pass.delay_sigma_s * 1e6:.1g} µs, "
        f"{low_pass.delay_cycles(low_pass.top_hz):.3g} ± "
        f"{low_pass.delay_sigma_cycles(low_pass.top_hz):.1g} cycle at {at}, if the low-pass has one pole; "
    )
    if low_pass.two_poles_delay_s is not None:
        return (
            f"{words}{low_pass.two_poles_delay_s * 1e6:.3g} µs with two equal poles, which these speeds do "
            "not rule out: half of the highest speed would. Without the delay of the converter"
        )
    if not low_pass.is_one_pole:
        return (
            f"{words}but the amplitude is up to {PERCENT * low_pass.misfit:.2g} % away from that of one "
            "pole: take the delay from data sheets"
        )
    return f"{words}the amplitudes agree with that. Without the delay of the converter"


def delay_set_words(over: OverSpeeds) -> str:
    estimate, delay_s = over.path.low_pass.delay_s, over.after.correction.conditioning.delay_s
    if delay_s and abs(delay_s - estimate) <= SAME_DELAY * estimate:
        return f"{delay_s * 1e6:.4g} µs, as estimated"
    if delay_s:
        return f"{delay_s * 1e6:.4g} µs, as given"
    return "0: no delay is removed" + (" (--delay estimate)" if estimate else "")


def _low_pass_words(over: OverSpeeds, where: Provenance) -> str:
    low_pass, corners = over.path.low_pass, over.after.corners
    if low_pass.rises:
        return "none: the amplitude rises with the speed"
    if not low_pass.is_detected:
        return "none detected"
    words = f"{corners.corner_hz / 1e3:.4g} ± {low_pass.corner_sigma_hz / 1e3:.1g} kHz"
    cosine = f", cosine {corners.cosine_corner_hz / 1e3:.4g} kHz" if corners.cosine_corner_hz else ""
    left, at = PERCENT * low_pass.left, speed_words(low_pass.top_hz, where)
    return f"{words}{cosine} (2001:05, 2001:06): {left:.0f} % of the amplitude at {at}"


def comparison(measured: Measurement, done: Installation, where: Provenance) -> list[Row]:
    found, calibration, on_samples = measured.found, measured.calibration, measured.on_samples
    before, fresh = measured.before, done.fresh

    def pair(one: float, other: float) -> tuple[str, str]:
        return percent(one, where), percent(other, where)

    return [
        Row(
            "table",
            table_words(before),
            table_words(found),
            crc32_before=f"{before.crc32:08X}",
            crc32=f"{calibration.table.crc32:08X}",
            entries=len(calibration.table),
        ),
        Row(
            "conditioning",
            conditioning_in_words(before.conditioning),
            conditioning_in_words(found.conditioning),
            conditioning=conditioning_words(calibration.conditioning),
        ),
        Row(
            "deviation, rms",
            *pair(on_samples.before_rms, calibration.residual_rms),
            before_rms_cycles=on_samples.before_rms,
            residual_rms_cycles=calibration.residual_rms,
        ),
        Row(
            "deviation, peak",
            *pair(on_samples.before_peak, calibration.residual_peak),
            before_peak_cycles=on_samples.before_peak,
            residual_peak_cycles=calibration.residual_peak,
        ),
        Row(
            "on fresh samples, rms",
            *(() if fresh is None else pair(fresh.before_rms, fresh.rms)),
            fresh_rms_cycles=fresh and fresh.rms,
        ),
        Row(
            "on fresh samples, peak",
            *(() if fresh is None else pair(fresh.before_peak, fresh.peak)),
            fresh_peak_cycles=fresh and fresh.peak,
        ),
        *([] if measured.over_speeds is None else speed_rows(measured.over_speeds, where)),
    ]


def facts(measured: Measurement, done: Installation, where: Provenance) -> list[Row]:
    calibration, samples, fresh = measured.calibration, measured.samples, done.fresh
    spike, meanwhile = measured.on_samples.spike, where.meanwhile
    duration = f", {samples.duration_s:.3g} s" if samples.duration_s else ""
    error = done.phase_error_cycles
    is_lost = meanwhile is not None and meanwhile.is_lost
    return [
        Row(
            "table is good to",
            percent(calibration.uncertainty_peak, where),
            uncertainty_rms_cycles=calibration.uncertainty_rms,
            uncertainty_peak_cycles=calibration.uncertainty_peak,
        ),
        Row(
            "noise of a sample",
            f"{percent(calibration.noise_cycles, where)}, {calibration.noise_counts:.2f} counts",
            noise_counts=calibration.noise_counts,
        ),
        Row(
            "samples",
            f"{len(samples)}{rate_words(samples)}{duration}; {samples.origin}",
            samples=len(samples),
            sample_rate_hz=samples.rate_hz,
            mean_rate_hz=samples.mean_rate_hz,
        ),
        Row(
            "left out",
            f"{missed_words(samples, where)}, {calibration.samples_rejected} faulty or not in whole cycles",
            samples_missed=samples.missed,
            samples_rejected=calibration.samples_rejected,
            intervals_without_sync=samples.skipped,
            module_missed=meanwhile and meanwhile.missed,
        ),
        Row(
            "coverage",
            f"{PERCENT * calibration.coverage:.0f} % of the cycle, {moved_words(calibration, where)}"
            + coverage_warning(measured),
            coverage=calibration.coverage,
            coverage_spike=spike and spike[0],
            cycles_used=calibration.cycles_used,
            module_cycles=meanwhile and meanwhile.cycles,
        ),
        Row(
            "method",
            f"{calibration.method}, {len(calibration.table)} entries",
            method=calibration.method.value,
        ),
        Row("fresh samples", f"{len(fresh.error)} used, {fresh.faulty} left out" if fresh else None),
        Row(
            "phase error, 2010:0C",
            None if error is None else f"{error:.3g} cycle, at the speed of this motion",
            phase_error_cycles=error,
        ),
        *([] if measured.over_speeds is None else path_rows(measured.over_speeds, where)),
        Row(
            "position of the module",
            "lost; a table does not bring it back (canfb why)" if is_lost else None,
            module_lost=meanwhile and meanwhile.is_lost,
        ),
        Row(
            "error of the table",
            None if calibration.cramer_rao_ratio is None else bound_words(calibration),
        ),
    ]


def rate_words(samples: TrackSamples) -> str:
    """The rate of the samples, averaged over pauses; "" if it is not known."""
    usual, mean = samples.rate_hz, samples.mean_rate_hz
    if not usual or not mean:
        return ""
    if samples.skipped:
        return f" at {mean:.4g} Hz in the mean, {usual:.4g} Hz between pauses"
    return f" at {usual:.6g} Hz"


def missed_words(samples: TrackSamples, where: Provenance) -> str:
    missed, skipped = samples.missed, samples.skipped
    counted = None if where.meanwhile is None else where.meanwhile.missed
    which = f" ({missed} SYNCs without a sample, about {skipped} intervals without a SYNC)" if skipped else ""
    told = counted is not None and (counted or skipped)
    return f"{missed + skipped} missed{which}{f', {counted} by the count of the module' if told else ''}"


def moved_words(calibration: Calibration, where: Provenance) -> str:
    by_module = None if where.meanwhile is None else where.meanwhile.cycles
    cycles = max(calibration.cycles_used, by_module or 0)
    per_turn = where.cycles_per_revolution
    turns = f" ({cycles / per_turn:.3g} revolutions)" if per_turn else ""
    return f"at least {cycles:.0f} cycles{turns}"


def coverage_warning(measured: Measurement) -> str:
    """Words on samples that accumulate at a phase, after a semicolon; or ""."""
    spike = measured.on_samples.spike
    if spike is None:
        return ""
    return f"; spiky: {spike[0]:.1f} times the mean at phase {spike[1]:.2f}, another speed is better"


def bound_words(calibration: Calibration) -> str:
    ratio, scatter = calibration.cramer_rao_ratio or 0.0, calibration.cramer_rao_scatter or 0.0
    measured = f"{ratio:.2f} ± {scatter * ratio:.2f} times the Cramér-Rao bound"
    if ratio * (1.0 - 2.0 * scatter) <= 1.0:
        return f"{measured}: as small as these samples allow"
    return f"{measured}: more than the noise of the converter; motion or tracks change"


def outcome(measured: Measurement, done: Installation, where: Provenance) -> str:
    if where.module is None:
        return "measured from a file: nothing was written to a module"
    if done.fresh is None:
        return "dry run: nothing was written to the module"
    unsaved = "not saved: the table is lost when the module is switched off (--save)"
    saved = f"saved ({done.saved_as})" if done.saved_as else unsaved
    return f"table {measured.calibration.table.crc32:08X}h is active and verified on fresh samples; {saved}"


def verdict(measured: Measurement, where: Provenance) -> str:
    calibration, on_samples, over = measured.calibration, measured.on_samples, measured.over_speeds
    good = f"The table itself is good to {PERCENT * calibration.uncertainty_peak:.2g} %."
    if over is not None:
        worst = max(one.after for one in over.errors)
        known = [one.before for one in over.errors if one.before is not None]
        falls = f", {PERCENT * max(known):.2g} % before" if len(known) == len(over.errors) else ""
        first, last = (speed_words(over.errors[n].hertz, where) for n in (0, -1))
        between = "" if len(over.errors) > 2 else " Two speeds fit any analog path: verify it with a third."
        return (
            f"Accepted. The error within a cycle is at most {PERCENT * worst:.2g} % of a cycle rms{falls}, "
            f"from {first} to {last}, on samples that were held out.{between} {good}"
        )
    factor = on_samples.before_rms / calibration.residual_rms if calibration.residual_rms > 0.0 else 0.0
    before, after = (f"{PERCENT * one:.2g} %" for one in (on_samples.before_rms, calibration.residual_rms))
    rest = (
        "; the rest is mostly noise of single samples"
        if calibration.residual_rms < 2.0 * calibration.noise_cycles
        else ""
    )
    if factor > 1.5:
        change = (
            f"The error within a cycle falls from {before} to {after} of a cycle rms, {factor:.0f} times "
            f"less{rest}."
        )
    elif factor < 1.0 / 1.5:
        change = f"The previous table is better: {before} of a cycle rms, {after} now."
    else:
        change = "The previous table is equally good: the encoder has not changed."
    return f"Accepted. {change} {good}"


def findings(measured: Measurement, done: Installation, where: Provenance) -> Findings:
    calibration = measured.calibration
    judged = Row(
        accepted=calibration.accepted,
        reason=calibration.reason.value,
        verdict=calibration.verdict,
        active=done.fresh is not None,
        saved=done.saved_as is not None,
        **where_words(where),
    )
    sections = [
        Section("Before and after", comparison(measured, done, where), ("before", "after")),
        Section("Measurement", facts(measured, done, where)),
    ]
    return Findings(sections, [verdict(measured, where), outcome(measured, done, where)], [judged])


def module_drift_result(
    found: tuple[float, float, float, float], active: Correction, where: Provenance
) -> Result:
    rms, peak, noise, coverage = found
    rows = [
        *_error_rows(rms, peak, active, where),
        Row(
            "noise of a sample",
            f"{percent(noise, where)} rms",
            new_table_rms_cycles=noise,
        ),
        Row("coverage", f"{PERCENT * coverage:.0f} %", coverage=coverage),
    ]
    return Result(as_figures(rows), as_lines(rows))


def drift_result(measured: Measurement, where: Provenance) -> Result:
    """Result of a check: the present error of the active table."""
    fresh, active = measured.calibration, measured.before
    found, change = (
        drift(fresh, active.table, active.conditioning),
        conditioning_change(fresh, active.conditioning),
    )
    is_significant = found.rms > 2.0 * fresh.uncertainty_rms
    now_rms, new_rms = measured.on_samples.before_rms, fresh.residual_rms
    changed = change and (
        f"offset {PERCENT * change['sine_offset']:+.2g} / {PERCENT * change['cosine_offset']:+.2g} % of the "
        f"amplitude, gain of the cosine {PERCENT * change['gain']:+.2g} %, "
        f"phase {change['phase_rad']:+.2g} rad"
    )
    rows = [
        *_error_rows(*found, active, where),
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
        Row("changed since", changed or None, changed=change),
        Row(drift_seen=is_significant, coverage=fresh.coverage, samples=fresh.samples_used),
    ]
    nothing = [] if is_significant else ["no drift within the uncertainty of this measurement"]
    return Result(as_figures(rows), [*as_lines(rows), *nothing])


def _error_rows(rms: float, peak: float, active: Correction, where: Provenance) -> list[Row]:
    return [
        Row(**where_words(where)),
        Row("active table", table_words(active), crc32=f"{active.crc32:08X}"),
        Row("its error now, rms", f"{percent(rms, where)} of a cycle", drift_rms_cycles=rms),
        Row("its error now, peak", f"{percent(peak, where)} of a cycle", drift_peak_cycles=peak),
    ]
