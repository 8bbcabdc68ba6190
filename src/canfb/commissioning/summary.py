"""The figures of a reference measurement: for the terminal, the report and programs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from canfb.calibration.result import Calibration
from canfb.commissioning.circumstances import Circumstances, percent, where_words
from canfb.commissioning.measurement import Measurement
from canfb.commissioning.path_summary import path_facts, path_json, speed_rows, speed_words
from canfb.commissioning.procedure import Installation
from canfb.commissioning.samples import TrackSamples
from canfb.commissioning.speed_measurement import SpeedMeasurement
from canfb.commissioning.table_file import conditioning_words
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import Correction

PERCENT = 100.0


@dataclass(frozen=True)
class Row:
    """One line of the comparison."""

    name: str
    before: str
    after: str


def comparison(measured: Measurement, done: Installation, where: Circumstances) -> list[Row]:
    """Before and after, in the words that are printed."""
    found, calibration, on_samples = measured.found, measured.calibration, measured.on_samples
    rows = [
        Row("table", table_words(measured.before), table_words(found)),
        Row(
            "conditioning",
            conditioning_in_words(measured.before.conditioning),
            conditioning_in_words(found.conditioning),
        ),
        Row(
            "deviation, rms",
            percent(on_samples.before_rms, where),
            percent(calibration.residual_rms, where),
        ),
        Row(
            "deviation, peak",
            percent(on_samples.before_peak, where),
            percent(calibration.residual_peak, where),
        ),
    ]
    if done.fresh is not None:
        fresh = done.fresh
        rows += [
            Row("on fresh samples, rms", percent(fresh.before_rms, where), percent(fresh.rms, where)),
            Row("on fresh samples, peak", percent(fresh.before_peak, where), percent(fresh.peak, where)),
        ]
    if isinstance(measured, SpeedMeasurement):
        rows += [Row(*words) for words in speed_rows(measured.over_speeds, where)]
    return rows


def facts(measured: Measurement, done: Installation, where: Circumstances) -> list[tuple[str, str]]:
    """What else there is to know of the measurement."""
    calibration, samples = measured.calibration, measured.samples
    duration = f", {samples.duration_s:.3g} s" if samples.duration_s else ""
    listed = [
        ("table is good to", percent(calibration.uncertainty_peak, where)),
        (
            "noise of a sample",
            f"{percent(calibration.noise_cycles, where)}, {calibration.noise_counts:.2f} counts",
        ),
        ("samples", f"{len(samples)}{rate_words(samples)}{duration}; {samples.origin}"),
        (
            "left out",
            f"{missed_words(samples, where)}, {calibration.samples_rejected} faulty or not in whole cycles",
        ),
        (
            "coverage",
            f"{PERCENT * calibration.coverage:.0f} % of the cycle, {moved_words(calibration, where)}"
            f"{coverage_warning(measured)}",
        ),
        ("method", f"{calibration.method}, {len(calibration.table)} entries"),
    ]
    if done.fresh is not None:
        listed.append(("fresh samples", f"{len(done.fresh.error)} used, {done.fresh.faulty} left out"))
    if done.phase_error_cycles is not None:
        listed.append(
            ("phase error, 2010:0C", f"{done.phase_error_cycles:.3g} cycle, at the speed of this motion")
        )
    if isinstance(measured, SpeedMeasurement):
        listed += path_facts(measured.over_speeds, where)
    if where.meanwhile is not None and where.meanwhile.is_lost:
        listed.append(("position of the module", "lost; a table does not bring it back (canfb why)"))
    if calibration.cramer_rao_ratio is not None:
        listed.append(("error of the table", bound_words(calibration)))
    return listed


def rate_words(samples: TrackSamples) -> str:
    """The rate of the samples, in the mean where they paused; "" if it is not known."""
    usual, mean = samples.rate_hz, samples.mean_rate_hz
    if not usual or not mean:
        return ""
    if samples.skipped:
        return f" at {mean:.4g} Hz in the mean, {usual:.4g} Hz between pauses"
    return f" at {usual:.6g} Hz"


def missed_words(samples: TrackSamples, where: Circumstances) -> str:
    """How many samples are missing, and how many the module says."""
    skipped, meanwhile = samples.skipped, where.meanwhile
    words = f"{samples.missed + skipped} missed"
    if skipped:
        words += f" ({samples.missed} SYNCs without a sample, about {skipped} intervals without a SYNC)"
    if meanwhile is not None and (meanwhile.missed or skipped):
        words += f", {meanwhile.missed} by the count of the module"
    return words


def moved_words(calibration: Calibration, where: Circumstances) -> str:
    """How far the machine has moved; from even samples alone that is open by whole cycles per sample."""
    by_module = None if where.meanwhile is None else where.meanwhile.cycles
    cycles = max(calibration.cycles_used, by_module or 0)
    per_turn = where.cycles_per_revolution
    turns = f" ({cycles / per_turn:.3g} revolutions)" if per_turn else ""
    return f"at least {cycles:.0f} cycles{turns}"


def coverage_warning(measured: Measurement) -> str:
    """Of samples that crowd at some phase: nothing, or words that begin with a semicolon."""
    spike = measured.on_samples.spike
    if spike is None:
        return ""
    return f"; spiky: {spike[0]:.1f} times the mean at phase {spike[1]:.2f}, another speed is better"


def bound_words(calibration: Calibration) -> str:
    """The measured error of the table against the Cramer-Rao bound, in words."""
    ratio, scatter = calibration.cramer_rao_ratio or 0.0, calibration.cramer_rao_scatter or 0.0
    measured = f"{ratio:.2f} ± {scatter * ratio:.2f} times the Cramér-Rao bound"
    if ratio * (1.0 - 2.0 * scatter) <= 1.0:
        return f"{measured}: as small as these samples allow"
    return f"{measured}: more than the noise of the converter; motion or tracks change"


def outcome(measured: Measurement, done: Installation, where: Circumstances) -> str:
    """One line: what the module computes with now."""
    if where.module is None:
        return "measured from a file: nothing was written to a module"
    if not done.active:
        return "dry run: nothing was written to the module"
    saved = f"saved ({done.saved_as})" if done.saved_as else done.save_note
    return f"table {measured.calibration.table.crc32:08X}h is active and verified on fresh samples; {saved}"


def verdict(measured: Measurement, where: Circumstances) -> str:
    """The verdict in plain words."""
    if isinstance(measured, SpeedMeasurement):
        return _verdict_over_speeds(measured, where)
    calibration, on_samples = measured.calibration, measured.on_samples
    factor = on_samples.before_rms / calibration.residual_rms if calibration.residual_rms > 0.0 else 0.0
    if factor > 1.5:
        change = (
            f"The error within a cycle falls from {PERCENT * on_samples.before_rms:.2g} % to "
            f"{PERCENT * calibration.residual_rms:.2g} % of a cycle rms, {factor:.0f} times less; the "
            "rest is mostly noise of single samples."
        )
    else:
        change = "The previous table is equally good: the encoder has not changed."
    return f"Accepted. {change} The table itself is good to {PERCENT * calibration.uncertainty_peak:.2g} %."


def _verdict_over_speeds(measured: SpeedMeasurement, where: Circumstances) -> str:
    errors = measured.over_speeds.errors
    worst = max(errors, key=lambda one: one.after)
    before = [one.before for one in errors if one.before is not None]
    falls = f", {PERCENT * max(before):.2g} % before" if len(before) == len(errors) else ""
    return (
        f"Accepted. The error within a cycle is at most {PERCENT * worst.after:.2g} % of a cycle rms"
        f"{falls}, from {speed_words(errors[0].hertz, where)} to {speed_words(errors[-1].hertz, where)}, on "
        f"samples that were held out. The table itself is good to "
        f"{PERCENT * measured.calibration.uncertainty_peak:.2g} %."
    )


def as_json(measured: Measurement, done: Installation, where: Circumstances) -> dict[str, Any]:
    """The figures for programs; cycles, counts, seconds."""
    calibration, samples, fresh = measured.calibration, measured.samples, done.fresh
    spike = measured.on_samples.spike
    return {
        "accepted": calibration.accepted,
        "reason": calibration.reason.value,
        "verdict": calibration.verdict,
        **where_words(where),
        "method": calibration.method.value,
        "samples": len(samples),
        "samples_missed": samples.missed,
        "samples_rejected": calibration.samples_rejected,
        "sample_rate_hz": samples.rate_hz,
        "mean_rate_hz": samples.mean_rate_hz,
        "intervals_without_sync": samples.skipped,
        "module_missed": None if where.meanwhile is None else where.meanwhile.missed,
        "module_cycles": None if where.meanwhile is None else where.meanwhile.cycles,
        "module_lost": None if where.meanwhile is None else where.meanwhile.is_lost,
        "coverage": calibration.coverage,
        "coverage_spike": None if spike is None else spike[0],
        "cycles_used": calibration.cycles_used,
        "crc32_before": f"{measured.before.crc32:08X}",
        "crc32": f"{calibration.table.crc32:08X}",
        "entries": len(calibration.table),
        "conditioning": conditioning_words(calibration.conditioning),
        "before_rms_cycles": measured.on_samples.before_rms,
        "before_peak_cycles": measured.on_samples.before_peak,
        "residual_rms_cycles": calibration.residual_rms,
        "residual_peak_cycles": calibration.residual_peak,
        "uncertainty_rms_cycles": calibration.uncertainty_rms,
        "uncertainty_peak_cycles": calibration.uncertainty_peak,
        "noise_counts": calibration.noise_counts,
        "fresh_rms_cycles": None if fresh is None else fresh.rms,
        "fresh_peak_cycles": None if fresh is None else fresh.peak,
        "phase_error_cycles": done.phase_error_cycles,
        "active": done.active,
        "saved": done.saved_as is not None,
        **(path_json(measured.over_speeds) if isinstance(measured, SpeedMeasurement) else {}),
    }


def table_words(used: Correction) -> str:
    """A table in a word or two."""
    return "none" if used.table is None else f"{used.crc32:08X}h, {len(used.table)} entries"


def conditioning_in_words(conditioning: Conditioning) -> str:
    """A conditioning in a few words."""
    if conditioning.is_identity:
        return "none"
    words = (
        f"offset {conditioning.sine_offset_counts:+.1f}/{conditioning.cosine_offset_counts:+.1f}, gain "
        f"{conditioning.sine_gain:.4f}/{conditioning.cosine_gain:.4f}, phase "
        f"{conditioning.phase_error_rad:+.4f} rad"
    )
    delays = (("cosine later by", conditioning.cosine_delay_s), ("delay", conditioning.delay_s))
    return ", ".join([words, *(f"{what} {delay_s * 1e6:.4g} µs" for what, delay_s in delays if delay_s)])
