"""The figures of ``canfb commission``: for the terminal, the report and programs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from canfb import objects as od
from canfb.calibrate.artefacts import REPORT, place_line
from canfb.calibrate.calibration_summary import delay_words
from canfb.commission.limit_choice import Choice, Observation
from canfb.commission.machine_figures import MachineFigures, smooth_acceleration
from canfb.files import write_whole
from canfb.master.machine_watch import Provenance, in_words, origins, where_words
from canfb.master.session import (
    JITTER,
    KINDS,
    SupervisionLimits,
)
from canfb.report import pictures
from canfb.report.page import figure, gallery, page, section, sentence, table
from canfb.report.pictures import lissajous
from canfb.rows import Findings, Row, Section, those
from canfb.signal.limits import RPM, samples_without_harm
from canfb.timing.syncs import USUAL_JITTER_S
from canfb.view.module_view import LIMIT_UNITS

# What a limit of 0 says.
NOTHING = {
    od.SUPERVISION_ACCELERATION: "not known",
    od.SUPERVISION_FROZEN: "off",
    JITTER.place: f"{1e3 * USUAL_JITTER_S:g} ms",
}
PARTS = {
    od.SUPERVISION_RESIDUAL_LIMIT: (1.0, " cycle"),
    od.SUPERVISION_PHASE_ERROR: (1.0, " cycle"),
    od.SUPERVISION_COARSE_LIMIT: (360.0, "°"),
}
"""Limits in 1/65536: of what, and its unit."""


@dataclass(frozen=True, eq=False)
class Commissioned:
    """What came out.

    before, new       the limits in the module before, and those that were chosen; choices: each with its
                      reason
    usual             what the module flagged during the measurement
    written, asked    the limits were written; that was asked for
    saved_as          object that saved them, None: not saved
    """

    observed: Observation
    before: SupervisionLimits
    new: SupervisionLimits
    choices: list[Choice]
    usual: Mapping[str, int]
    margin: float
    written: bool
    asked: bool
    saved_as: str | None
    where: Provenance

    @property
    def machine(self) -> MachineFigures:
        return self.observed.machine

    @property
    def largest_acceleration(self) -> float:
        """Of the machine, cycles per interval squared: 2010:02, or what was seen while that is not known."""
        return self.new.bounds(self.machine.interval_s).acceleration or self.machine.motion.acceleration

    def deviation(self, limits: SupervisionLimits) -> float:
        """L + a of docs/supervision.md with these limits; cycles."""
        return limits.bounds(self.machine.interval_s).residual_limit + self.largest_acceleration

    def without_harm(self, limits: SupervisionLimits) -> int:
        return samples_without_harm(self.deviation(limits))


def machine_facts(done: Commissioned) -> list[Row]:
    machine, n = done.machine, done.new.cycles_per_revolution
    motion, tracks, samples = machine.motion, machine.tracks, done.observed.samples
    slowest, fastest = (machine.rad(speed, 1, n) * RPM for speed in (motion.slowest, motion.fastest))
    acceleration, jerk = machine.rad(motion.acceleration, 2, n), machine.rad(motion.jerk, 3, n)
    low_pass = machine.low_pass if machine.low_pass is not None and machine.low_pass.is_detected else None
    return [
        Row(
            "samples",
            f"{len(samples)} at {samples.rate_hz:.6g} Hz, {samples.missed} missed; {samples.origin}",
            samples=len(samples),
            samples_missed=samples.missed,
            sample_rate_hz=samples.rate_hz,
        ),
        Row(
            "speed",
            f"{slowest:.4g} to {fastest:.4g} rpm; at most {motion.top_speed:.3g} cycles per sample",
            speed_least_rpm=slowest,
            speed_most_rpm=fastest,
        ),
        Row(
            "distance",
            f"{motion.turned / n:.3g} revolutions from the lowest to the highest position",
            turned_revolutions=motion.turned / n,
        ),
        Row(
            "largest acceleration",
            f"{_rounded(acceleration)} rad/s², {motion.acceleration:.3g} cycle per interval²",
            acceleration_rad_s2=acceleration,
            acceleration_cycles=motion.acceleration,
        ),
        Row(
            "largest jerk",
            f"{_rounded(jerk)} rad/s³, {motion.jerk:.3g} cycle per interval³",
            jerk_rad_s3=jerk,
            jerk_cycles=motion.jerk,
        ),
        Row(
            "jitter",
            "not known"
            if machine.jitter_s is None or machine.off_grid_s is None
            else f"{1e6 * machine.jitter_s:.3g} µs rms from SYNC to SYNC; at most "
            f"{1e6 * machine.off_grid_s:.3g} µs off the even grid",
            jitter_s=machine.jitter_s,
            off_grid_s=machine.off_grid_s,
        ),
        Row(
            "change in time",
            f"errors of the phase differ by {machine.change_cycles:.2g} cycle rms"
            if machine.change_cycles
            else "none is seen",
            change_rms_cycles=machine.change_cycles,
        ),
        Row(
            "residual",
            f"{motion.residual_rms:.3g} cycle rms, at most {motion.residual_peak:.3g}",
            residual_rms_cycles=motion.residual_rms,
            residual_peak_cycles=motion.residual_peak,
        ),
        Row(
            "of that noise",
            f"{motion.residual_noise:.3g} cycle rms; converter {tracks.noise_counts:.2f} counts rms",
            phase_noise_cycles=motion.noise,
            converter_noise_counts=tracks.noise_counts,
        ),
        Row(
            "amplitude",
            f"mean {tracks.mean:.0f}, {tracks.least:.0f} to {tracks.most:.0f} counts",
            amplitude_mean_counts=tracks.mean,
            amplitude_least_counts=tracks.least,
            amplitude_most_counts=tracks.most,
        ),
        Row(
            "low-pass",
            _low_pass_words(done),
            corner_hz=low_pass and low_pass.corner_hz,
            corner_uncertainty_hz=low_pass and low_pass.corner_sigma_hz,
            delay_estimate_s=low_pass and low_pass.delay_s,
            delay_estimate_uncertainty_s=low_pass and low_pass.delay_sigma_s,
        ),
        Row("flagged meanwhile", in_words(done.usual) or "nothing", flagged_meanwhile=dict(done.usual)),
    ]


def _low_pass_words(done: Commissioned) -> str:
    low_pass = done.machine.low_pass
    if low_pass is None:
        return "not known: too few speeds were seen"
    words = delay_words(low_pass, done.where)
    if not low_pass.is_detected:
        return f"delay {words}"
    return f"{low_pass.corner_hz / 1e3:.4g} kHz; delay {words}. 2002:07 stays as it is"


def _rounded(value: float) -> str:
    """Three figures, without a power of ten: 18100 in place of 1.81e+04."""
    return f"{float(f'{value:.3g}'):.15g}"


def notes(done: Commissioned) -> list[str]:
    missed = done.observed.samples.missed
    return those(
        (
            done.machine.motion.turned < done.new.cycles_per_revolution,
            "the machine moved less than one revolution: the amplitude elsewhere on the scale is not known",
        ),
        (missed, f"{missed} samples did not come: each is flagged, whatever the limits"),
    )


def limit_rows(done: Commissioned) -> list[Row]:
    """Object and name; before, proposed, why."""
    interval_s, n = done.machine.interval_s, done.new.cycles_per_revolution
    return [
        Row(
            f"{od.place_text(one.place)} {KINDS[one.place].name}",
            value_words(one, one.before, interval_s, n),
            value_words(one, one.value, interval_s, n) if one.changes else "as it is",
            one.why,
            object=od.place_text(one.place),
            name=KINDS[one.place].name,
            unit=KINDS[one.place].unit,
            before=one.before,
            proposed=one.value,
            changes=one.changes,
            why=one.why,
        )
        for one in done.choices
    ]


def value_words(choice: Choice, value: float, interval_s: float, cycles_per_revolution: int) -> str:
    place = choice.place
    if not value and place in NOTHING:
        return f"0, {NOTHING[place]}"
    if place == od.SUPERVISION_ACCELERATION:
        cycles = value * cycles_per_revolution / (2.0 * math.pi) * interval_s**2
        return f"{value:.3g} rad/s² ({cycles:.2g} cycle)"
    if place == JITTER.place:
        return f"{1e6 * value:.0f} µs"
    if place in PARTS:
        whole, unit = PARTS[place]
        return f"{value:.0f} ({whole * value / LIMIT_UNITS:.3g}{unit})"
    return f"{value:.0f} {KINDS[place].unit}"


def detection_words(done: Commissioned) -> str:
    before, new = (done.without_harm(one) for one in (done.before, done.new))
    bound = f"accelerations up to {done.largest_acceleration:.3g} cycle per interval²"
    return (
        f"Up to {new} bad samples in a row of any phase cannot falsify the cycle count unseen, {before} with "
        "the limits before; a single one is flagged if its phase is off by more than "
        f"{done.deviation(done.new):.3g} cycle, {min(0.5, done.deviation(done.before)):.3g} before "
        f"({bound})"
    )


def kept_words(done: Commissioned) -> str:
    interval_s, motion = done.machine.interval_s, done.largest_acceleration
    before, new = (one.chain_limits(interval_s).kept_samples(motion) for one in (done.before, done.new))
    return (
        f"After up to {new} missed or flagged samples in a row the position is certain, {before} with the "
        f"limits before (2010:03 bridges {done.new.coast_samples}). A machine that exceeds the acceleration "
        "or the phase error declared here can leave a position valid and wrong after a fault"
    )


def outcome(done: Commissioned) -> str:
    if done.written:
        saved = (
            f"saved ({done.saved_as})"
            if done.saved_as
            else "not saved: --save keeps them over a loss of power"
        )
        return f"the limits are in force, and nothing was flagged that was not flagged before; {saved}"
    if done.asked:
        return "nothing to write: the module has these limits already"
    return "nothing was written to the module: --write does it"


def findings(done: Commissioned) -> Findings:
    interval_s, motion = done.machine.interval_s, done.largest_acceleration
    figures = Row(
        margin=done.margin,
        notes=notes(done),
        residual_limit_in_force_cycles=done.new.bounds(interval_s).residual_limit,
        deviation_cycles=done.deviation(done.new),
        deviation_before_cycles=done.deviation(done.before),
        bad_samples_detected=done.without_harm(done.new),
        bad_samples_detected_before=done.without_harm(done.before),
        missed_samples_kept=done.new.chain_limits(interval_s).kept_samples(motion),
        missed_samples_kept_before=done.before.chain_limits(interval_s).kept_samples(motion),
        written=done.written,
        saved=done.saved_as is not None,
        **where_words(done.where),
    )
    sections = [
        Section("The machine", machine_facts(done)),
        Section("Limits", limit_rows(done), ("before", "proposed", "why"), beside=2, key="limits"),
    ]
    said = [detection_words(done), kept_words(done), outcome(done), *notes(done)]
    return Findings(sections, said, [figures])


FOOTER = (
    "Made by canfb commission. L is the residual limit in force, a the largest acceleration, in "
    "cycles and sampling intervals. The limits hold for the motion that was seen, times the margin."
)


def write_page(folder: Path, done: Commissioned) -> Path:
    path = folder / REPORT
    found = findings(done)
    body = (
        "".join(map(section, reversed(found.sections)))
        + gallery("Pictures", _pictures(done))
        + table("Origin", origins(done.where), style="origin")
    )
    said = list(map(sentence, found.said))
    text = page("Limits of the supervision", place_line(done.where), said, body, FOOTER)
    write_whole(path, text.encode())
    return path


def _pictures(done: Commissioned) -> list[str]:
    machine, interval_s = done.machine, done.machine.interval_s
    old, new = (limits.bounds(interval_s).residual_limit for limits in (done.before, done.new))
    low, high = (
        done.new.values[place] for place in (od.ENCODER_LOWEST_AMPLITUDE, od.ENCODER_HIGHEST_AMPLITUDE)
    )
    largest = done.new.bounds(interval_s).acceleration or 0.0
    samples, noise = done.observed.samples, machine.motion.noise
    to_rad = machine.rad(1.0, 2, done.new.cycles_per_revolution)
    listed = [
        (
            "Residual",
            "of each sample, eq. 12, with the residual limit in force",
            pictures.residual_histogram(machine.motion.residual, old, new),
        ),
        (
            "Amplitude over the phase",
            "lowest, mean and highest of the samples in each 1/64 cycle, with its limits",
            pictures.amplitude_over_phase(machine.tracks.over_phase, low, high),
        ),
        (
            "Acceleration over time",
            "averaged as far as the noise demands, with the limit 2010:02",
            pictures.acceleration_over_time(
                to_rad * smooth_acceleration(machine.motion.residual, noise), interval_s, to_rad * largest
            ),
        ),
        (
            "Lissajous figure",
            "all samples within the new limits of the amplitude",
            lissajous(
                samples.sine,
                samples.cosine,
                done.observed.used.conditioning,
                done.new.chain_limits(interval_s).sample,
            ),
        ),
    ]
    return [figure(name, text, svg) for name, text, svg in listed]
