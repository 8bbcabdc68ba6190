"""The figures of ``canfb commission``: for the terminal, the report and programs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from canfb import objects as od
from canfb.calibrate.calibration_summary import delay_words
from canfb.calibration.path_fit import LowPass
from canfb.commission.limit_choice import Choice, MachineSeen
from canfb.commission.machine_seen import Observation
from canfb.master.circumstances import Circumstances, where_words
from canfb.master.machine_watch import in_words
from canfb.master.supervision_limits import (
    KINDS,
    SupervisionLimits,
)
from canfb.signal.limits import ROUNDING, safe_deviation, samples_without_harm
from canfb.signal.third_order import THIRD
from canfb.view.limits_in_force import LIMIT_UNITS

ROWS = 3  # of the table of detection, at least
MOST_ROWS = 12
SAFE_THIRD_ORDER = 0.25  # L + j at which one bad sample is without harm, and never two (docs/legal-motion.md)

LEAST_JITTER_S = 1e-8


@dataclass(frozen=True, eq=False)
class Commissioned:
    """What came out.

    seen              the machine
    before, new       the limits in the module before, and those that were chosen
    choices           each limit, with its reason
    usual             what the module flagged during the measurement
    margin            factor beyond what was seen
    written, asked    the limits were written; that was asked for
    saved_as          object that saved them, None: not saved
    """

    seen: Observation
    before: SupervisionLimits
    new: SupervisionLimits
    choices: list[Choice]
    usual: Mapping[str, int]
    margin: float
    written: bool
    asked: bool
    saved_as: str | None
    where: Circumstances

    @property
    def machine(self) -> MachineSeen:
        """What was seen of it."""
        return self.seen.seen

    @property
    def largest_acceleration(self) -> float:
        """Of the machine, cycles per interval squared: 2010:02, or what was seen while that is not known."""
        return self.new.acceleration_cycles(self.machine.interval_s) or self.machine.motion.acceleration

    @property
    def is_third_order(self) -> bool:
        """The module predicts by third order."""
        return self.new.prediction_order == THIRD

    @property
    def largest_motion(self) -> float:
        """What the machine leaves as a residual: its acceleration, by third order its jerk; cycles."""
        if not self.is_third_order:
            return self.largest_acceleration
        return self.new.bounds(self.machine.interval_s).jerk or self.machine.motion.jerk

    def deviation(self, limits: SupervisionLimits) -> float:
        """L + a of docs/legal-motion.md with these limits, L + j of docs/legal-motion.md; cycles."""
        return limits.residual_limit(self.machine.interval_s) + self.largest_motion

    def safe(self, count: int) -> float:
        """The largest deviation at which so many bad samples in a row are without harm, cycles."""
        if self.is_third_order:
            return SAFE_THIRD_ORDER if count == 1 else 0.0
        return safe_deviation(count)

    def without_harm(self, limits: SupervisionLimits) -> int:
        """Bad samples in a row that are without harm with these limits."""
        if self.is_third_order:
            return int(self.deviation(limits) <= SAFE_THIRD_ORDER * (1.0 + ROUNDING))
        return samples_without_harm(self.deviation(limits))


def machine_facts(done: Commissioned) -> list[tuple[str, str]]:
    """What was seen of the machine."""
    machine, n = done.machine, done.new.cycles_per_revolution
    motion, tracks, samples = machine.motion, machine.tracks, done.seen.samples
    slowest, fastest = (_rpm(machine, speed, n) for speed in (motion.slowest, motion.fastest))
    return [
        ("samples", f"{len(samples)} at {samples.rate_hz:.6g} Hz, {samples.missed} missed; {samples.origin}"),
        ("speed", f"{slowest:.4g} to {fastest:.4g} rpm; at most {motion.top_speed:.3g} cycles per sample"),
        ("distance", f"{motion.turned / n:.3g} revolutions from the lowest to the highest position"),
        (
            "largest acceleration",
            f"{_rounded(machine.rad(motion.acceleration, 2, n))} rad/s², "
            f"{motion.acceleration:.3g} cycle per interval²",
        ),
        (
            "largest jerk",
            f"{_rounded(machine.rad(motion.jerk, 3, n))} rad/s³, {motion.jerk:.3g} cycle per interval³",
        ),
        (
            "jitter",
            "not known" if machine.jitter_s is None else f"{_jitter(machine.jitter_s)} from SYNC to SYNC",
        ),
        ("residual", f"{motion.residual_rms:.3g} cycle rms, at most {motion.residual_peak:.3g}"),
        (
            "of that noise",
            f"{motion.residual_noise:.3g} cycle rms; converter {tracks.noise_counts:.2f} counts rms",
        ),
        ("amplitude", f"mean {tracks.mean:.0f}, {tracks.least:.0f} to {tracks.most:.0f} counts"),
        ("low-pass", _low_pass_words(done)),
        ("flagged meanwhile", in_words(done.usual) or "nothing"),
    ]


def _low_pass_words(done: Commissioned) -> str:
    """What the amplitude over the speed says of corner and delay; commission does not write 2002:07."""
    low_pass = done.machine.low_pass
    if low_pass is None:
        return "not known: too few speeds were seen"
    words = delay_words(low_pass, done.where)
    if not low_pass.is_seen:
        return f"delay {words}"
    return f"{low_pass.corner_hz / 1e3:.4g} kHz; delay {words}. 2002:07 stays as it is"


def _rounded(value: float) -> str:
    """Three figures, without a power of ten: 18100 in place of 1.81e+04."""
    return f"{float(f'{value:.3g}'):.15g}"


def _jitter(jitter_s: float) -> str:
    """In µs; what no clock of a receiver resolves is only a bound."""
    return f"{1e6 * jitter_s:.3g} µs" if jitter_s >= LEAST_JITTER_S else f"below {1e6 * LEAST_JITTER_S:g} µs"


def notes(done: Commissioned) -> list[str]:
    """What the operator should know of the measurement."""
    said = []
    n = done.new.cycles_per_revolution
    if done.machine.motion.turned < n:
        said.append(
            "the machine moved less than one revolution: the amplitude elsewhere on the scale is not known"
        )
    if done.seen.samples.missed:
        said.append(f"{done.seen.samples.missed} samples did not come: each is flagged, whatever the limits")
    return said


def limit_rows(done: Commissioned) -> list[tuple[str, str, str, str]]:
    """Object and name, before, proposed, why."""
    interval_s, n = done.machine.interval_s, done.new.cycles_per_revolution
    return [
        (
            f"{od.place_text(one.place)} {one.name}",
            value_words(one, one.before, interval_s, n),
            value_words(one, one.value, interval_s, n) if one.changes else "as it is",
            one.why,
        )
        for one in done.choices
    ]


def value_words(choice: Choice, value: float, interval_s: float, cycles_per_revolution: int) -> str:
    """A value with its unit, as people read it."""
    if choice.place in (od.SUPERVISION_RESIDUAL_LIMIT, od.SUPERVISION_PHASE_ERROR):
        return f"{value:.0f} ({value / LIMIT_UNITS:.3g} cycle)"
    if choice.place == od.SUPERVISION_COARSE_LIMIT:
        return f"{value:.0f} ({360.0 * value / LIMIT_UNITS:.3g}°)"
    if choice.place == od.SUPERVISION_ACCELERATION:
        if value == 0.0:
            return "0, not known"
        cycles = value * cycles_per_revolution / (2.0 * math.pi) * interval_s**2
        return f"{value:.3g} rad/s² ({cycles:.2g} cycle)"
    if choice.place == od.SUPERVISION_JERK:
        if value == 0.0:
            return "0, not known"
        cycles = value * cycles_per_revolution / (2.0 * math.pi) * interval_s**3
        return f"{value:.3g} rad/s³ ({cycles:.2g} cycle)"
    if choice.place == od.SUPERVISION_FROZEN and not value:
        return "0, off"
    return f"{value:.0f} {KINDS[choice.place].unit}"


def detection_rows(done: Commissioned) -> list[tuple[str, str, str, str]]:
    """Bad samples in a row: at most so much L + a, whether it holds before and with the new limits."""
    last = 2 if done.is_third_order else min(MOST_ROWS, max(ROWS, done.without_harm(done.new) + 1))
    words = {True: "detected", False: "not for sure"}
    return [
        (
            str(count),
            f"{done.safe(count):.3g}",
            words[done.deviation(done.before) <= done.safe(count)],
            words[done.deviation(done.new) <= done.safe(count)],
        )
        for count in range(1, last + 1)
    ]


def sum_words(done: Commissioned) -> str:
    """What the bad samples are held against."""
    return f"L + {'j' if done.is_third_order else 'a'} at most"


def detection_words(done: Commissioned) -> str:
    """One sentence."""
    before, new = (done.without_harm(one) for one in (done.before, done.new))
    bound = f"accelerations up to {done.largest_motion:.3g} cycle per interval²"
    if done.is_third_order:
        bound = f"jerks up to {done.largest_motion:.3g} cycle per interval³"
    return (
        f"Up to {new} bad samples in a row of any phase cannot falsify the cycle count unseen, {before} with "
        "the limits before; a single one is flagged if its phase is off by more than "
        f"{done.deviation(done.new):.3g} cycle, {min(0.5, done.deviation(done.before)):.3g} before "
        f"({bound})"
    )


def kept_words(done: Commissioned) -> str:
    """One sentence on missed samples."""
    interval_s, motion = done.machine.interval_s, done.largest_motion
    before, new = (one.kept_samples(interval_s, motion) for one in (done.before, done.new))
    return (
        f"After up to {new} missed or flagged samples in a row the position is certain, {before} with the "
        f"limits before (2010:03 bridges {done.new.coast_samples}). A machine that exceeds the acceleration, "
        "the jerk or the phase error declared here can leave a position valid and wrong after a fault"
    )


def outcome(done: Commissioned) -> str:
    """One line: what is in the module now."""
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


def as_lines(done: Commissioned) -> list[str]:
    """For people."""
    lines = [f"{name:21}{text}" for name, text in machine_facts(done)]
    lines += [f"note: {text}" for text in notes(done)]
    rows = [("", "before", "proposed"), *(row[:3] for row in limit_rows(done))]
    first, second = (max(len(row[k]) for row in rows) for k in (0, 1))
    lines.append("")
    for row, choice in zip(rows, [None, *done.choices], strict=True):
        lines.append(f"{row[0]:{first}}  {row[1]:{second}}  {row[2]}".rstrip())
        if choice is not None:
            lines.append(f"    {choice.why}")
    lines += ["", f"{'bad samples':13}{sum_words(done):15}{'before':14}proposed"]
    lines += [f"{row[0]:13}{row[1]:15}{row[2]:14}{row[3]}" for row in detection_rows(done)]
    return [*lines, "", detection_words(done), kept_words(done), outcome(done)]


def as_figures(done: Commissioned) -> dict[str, Any]:
    """For programs; units in the names, intervals are those of the samples."""
    machine, n = done.machine, done.new.cycles_per_revolution
    motion, tracks = machine.motion, machine.tracks
    return {
        **where_words(done.where),
        "samples": len(done.seen.samples),
        "samples_missed": done.seen.samples.missed,
        "sample_rate_hz": done.seen.samples.rate_hz,
        "speed_least_rpm": _rpm(machine, motion.slowest, n),
        "speed_most_rpm": _rpm(machine, motion.fastest, n),
        "turned_revolutions": motion.turned / n,
        "acceleration_rad_s2": machine.rad(motion.acceleration, 2, n),
        "acceleration_cycles": motion.acceleration,
        "jerk_rad_s3": machine.rad(motion.jerk, 3, n),
        "jerk_cycles": motion.jerk,
        "jitter_s": machine.jitter_s,
        "phase_noise_cycles": motion.noise,
        "residual_rms_cycles": motion.residual_rms,
        "residual_peak_cycles": motion.residual_peak,
        "converter_noise_counts": tracks.noise_counts,
        "amplitude_mean_counts": tracks.mean,
        "amplitude_least_counts": tracks.least,
        "amplitude_most_counts": tracks.most,
        **_low_pass_json(machine.low_pass),
        "flagged_meanwhile": dict(done.usual),
        "margin": done.margin,
        "notes": notes(done),
        "limits": [
            {
                "object": od.place_text(one.place),
                "name": one.name,
                "unit": KINDS[one.place].unit,
                "before": one.before,
                "proposed": one.value,
                "changes": one.changes,
                "why": one.why,
            }
            for one in done.choices
        ],
        "residual_limit_in_force_cycles": done.new.residual_limit(machine.interval_s),
        "deviation_cycles": done.deviation(done.new),
        "deviation_before_cycles": done.deviation(done.before),
        "bad_samples_detected": done.without_harm(done.new),
        "bad_samples_detected_before": done.without_harm(done.before),
        "missed_samples_kept": done.new.kept_samples(machine.interval_s, done.largest_motion),
        "missed_samples_kept_before": done.before.kept_samples(machine.interval_s, done.largest_motion),
        "written": done.written,
        "saved": done.saved_as is not None,
    }


def _low_pass_json(low_pass: LowPass | None) -> dict[str, float | None]:
    seen = low_pass is not None and low_pass.is_seen
    return {
        "corner_hz": low_pass.corner_hz if low_pass and seen else None,
        "corner_uncertainty_hz": low_pass.corner_sigma_hz if low_pass and seen else None,
        "delay_estimate_s": low_pass.delay_s if low_pass and seen else None,
        "delay_estimate_uncertainty_s": low_pass.delay_sigma_s if low_pass and seen else None,
    }


def _rpm(machine: MachineSeen, speed: float, cycles_per_revolution: int) -> float:
    return machine.rad(speed, 1, cycles_per_revolution) * 60.0 / (2.0 * math.pi)
