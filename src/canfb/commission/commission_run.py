"""``canfb commission`` from the first sample to the last file, and its figures.

New limits are written, read back, observed and saved; a failure restores the previous ones.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from canfb import objects as od
from canfb.calibrate.artefacts import keep_samples, place_line
from canfb.calibrate.calibration_run import Steps
from canfb.calibrate.calibration_summary import delay_words
from canfb.calibrate.measurement import supervise
from canfb.commission.limit_choice import LEAST_SAMPLES, Choice, choose, observe, value_words
from canfb.commission.machine_figures import Observation, smooth_acceleration
from canfb.errors import CanfbError
from canfb.files import REPORT, write_whole
from canfb.master.access import CommissioningError, Master, NodeAccess, without_restart
from canfb.master.all_or_nothing import Guard, change, check_can_save, check_unlocked
from canfb.master.machine_watch import (
    Provenance,
    SpeedReading,
    SpeedReadings,
    check_valid,
    counted,
    in_words,
    origins,
    read_counters,
    watch,
    where_words,
)
from canfb.master.samples import UPLOAD_PART, TrackSamples, listen, record
from canfb.master.session import KINDS, Session, SupervisionLimits, check_limits, write_limits
from canfb.report import pictures
from canfb.report.page import figure, gallery, page, section, table
from canfb.rows import Findings, Result, Row, Section, those
from canfb.signal.chain_config import ChainLimits
from canfb.signal.limits import RPM, samples_without_harm
from canfb.view.module_view import coarse_layout


@dataclass(frozen=True, kw_only=True)
class CommissionOptions:
    """The options of ``canfb commission``; ``recording``: samples of 2050h; ``line``: the command."""

    seconds: float = 60.0
    margin: float = 2.0
    acceleration: float = 0.0
    recording: bool = False
    write: bool = False
    save: bool = False
    watch_s: float = 10.0
    out: Path | None = None
    line: str = ""


@dataclass(frozen=True, eq=False)
class Commissioned:
    """Result of ``canfb commission``.

    before, new       limits of the chain before, and chosen ones; choices: each with its reason
    coast_samples     2010:03
    usual             samples that the module flagged during the measurement, by fault
    written           the limits were written
    saved_as          object that saved them, None: not saved
    """

    observed: Observation
    before: ChainLimits
    new: ChainLimits
    coast_samples: int
    choices: list[Choice]
    usual: Mapping[str, int]
    wishes: CommissionOptions
    written: bool
    saved_as: str | None
    where: Provenance

    @property
    def largest_acceleration(self) -> float:
        """Of the machine, cycles per interval^2: 2010:02, or the measured one if that is 0."""
        return self.new.acceleration or self.observed.motion.acceleration

    def deviation(self, limits: ChainLimits) -> float:
        """L + a of docs/supervision.md with these limits; cycles."""
        return limits.residual_limit + self.largest_acceleration

    def without_harm(self, limits: ChainLimits) -> int:
        return samples_without_harm(self.deviation(limits))


def machine_facts(done: Commissioned) -> list[Row]:
    machine, n = done.observed, done.new.cycles_per_revolution
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
            f"phase errors differ by {motion.change:.2g} cycle rms" if motion.change else "none detected",
            change_rms_cycles=motion.change,
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
    low_pass = done.observed.low_pass
    if low_pass is None:
        return "not known: too few speeds"
    words = delay_words(low_pass, done.where)
    if not low_pass.is_detected:
        return f"delay {words}"
    return f"{low_pass.corner_hz / 1e3:.4g} kHz; delay {words}. 2002:07 is unchanged"


def _rounded(value: float) -> str:
    """Three figures without exponent: 18100, not 1.81e+04."""
    return f"{float(f'{value:.3g}'):.15g}"


def notes(done: Commissioned) -> list[str]:
    missed = done.observed.samples.missed
    return those(
        (
            done.observed.motion.turned < done.new.cycles_per_revolution,
            "the machine moved less than one revolution: the amplitude elsewhere on the scale is not known",
        ),
        (missed, f"{missed} samples are missing: each is flagged with any limits"),
    )


def limit_rows(done: Commissioned) -> list[Row]:
    """A row for each limit: object and name; before, proposed, reason."""
    interval_s, n = done.observed.interval_s, done.new.cycles_per_revolution
    return [
        Row(
            f"{od.place_text(one.place)} {KINDS[one.place].name}",
            value_words(one, one.before, interval_s, n),
            value_words(one, one.value, interval_s, n) if one.changes else "unchanged",
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


def detection_words(done: Commissioned) -> str:
    before, new = (done.without_harm(one) for one in (done.before, done.new))
    return (
        f"Up to {new} bad samples in a row of any phase cannot falsify the cycle count unseen, {before} with "
        "the limits before; a single one is flagged if its phase is off by more than "
        f"{min(0.5, done.deviation(done.new)):.3g} cycle, {min(0.5, done.deviation(done.before)):.3g} before "
        f"(accelerations up to {done.largest_acceleration:.3g} cycle per interval²)"
    )


def kept_words(done: Commissioned) -> str:
    before, new = (one.kept_samples(done.largest_acceleration) for one in (done.before, done.new))
    return (
        f"After up to {new} missed or flagged samples in a row the position is certain, {before} with the "
        f"limits before (2010:03 bridges {done.coast_samples}). A machine that exceeds the "
        "acceleration or the phase error declared here can leave a position valid and wrong after a fault"
    )


def outcome(done: Commissioned) -> str:
    if done.written:
        saved = (
            f"saved ({done.saved_as})" if done.saved_as else "not saved: --save keeps them over a power-off"
        )
        return f"the limits are in force, and nothing was flagged that was not flagged before; {saved}"
    if done.wishes.write:
        return "nothing to write: the module has these limits already"
    return "nothing was written to the module: use --write"


def findings(done: Commissioned) -> Findings:
    motion = done.largest_acceleration
    figures = Row(
        margin=done.wishes.margin,
        notes=notes(done),
        residual_limit_in_force_cycles=done.new.residual_limit,
        deviation_cycles=done.deviation(done.new),
        deviation_before_cycles=done.deviation(done.before),
        bad_samples_detected=done.without_harm(done.new),
        bad_samples_detected_before=done.without_harm(done.before),
        missed_samples_kept=done.new.kept_samples(motion),
        missed_samples_kept_before=done.before.kept_samples(motion),
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
    "cycles and sampling intervals. The limits hold for the measured motion, times the margin."
)


def write_page(folder: Path, done: Commissioned) -> Path:
    path = folder / REPORT
    found = findings(done)
    body = (
        "".join(map(section, reversed(found.sections)))
        + gallery("Pictures", _pictures(done))
        + table("Origin", origins(done.where), style="origin")
    )
    write_whole(
        path, page("Limits of the supervision", place_line(done.where), found.said, body, FOOTER).encode()
    )
    return path


def _pictures(done: Commissioned) -> list[str]:
    machine, new = done.observed, done.new
    to_rad = machine.rad(1.0, 2, new.cycles_per_revolution)
    return [
        figure(
            "Residual",
            "of each sample, eq. 12, with the residual limit in force",
            pictures.residual_histogram(
                machine.motion.residual, done.before.residual_limit, new.residual_limit
            ),
        ),
        figure(
            "Amplitude over the phase",
            "lowest, mean and highest of the samples in each 1/64 cycle, with its limits",
            pictures.amplitude_over_phase(
                machine.tracks.over_phase, new.sample.amplitude_low_counts, new.sample.amplitude_high_counts
            ),
        ),
        figure(
            "Acceleration over time",
            "averaged as the noise requires, with the limit 2010:02",
            pictures.acceleration_over_time(
                to_rad * smooth_acceleration(machine.motion.residual),
                machine.interval_s,
                to_rad * (new.acceleration or 0.0),
            ),
        ),
        figure(
            "Lissajous figure",
            "all samples within the new limits of the amplitude",
            pictures.lissajous(
                machine.samples.sine, machine.samples.cosine, machine.used.conditioning, new.sample
            ),
        ),
    ]


Values = Mapping[od.Multiplexer, float]


def set_limits(
    module: NodeAccess,
    before: Values,
    new: Values,
    watched: Callable[[], None],
    guard: Guard,
    *,
    keep: bool = False,
    step: Callable[[str], None] = lambda text: None,
) -> str | None:
    """Write ``new``, check by ``watched``, save if ``keep``; returns the object that saved.

    After a failure (CommissioningError) or an interruption ``before`` is restored, and saved again if saving
    had begun.
    """

    def act() -> None:
        step("writing the limits")
        write_limits(module, new)
        step("watching the machine with the new limits")
        watched()
        check_limits(module, new)  # another master may have changed them

    return change(
        module,
        guard,
        act,
        lambda: write_limits(module, before),
        what="the limits from before",
        undone=lambda: f"the limits from before are in force in {module.name}{_position(module)}",
        keep=keep,
        step=step,
    )


def _position(module: NodeAccess) -> str:
    try:
        status = module.integer(*od.FEEDBACK_STATUS, "H")
    except CanfbError:
        return ""
    return (
        f"; its position is lost: canfb why {module.node_id:#04x} says what brings it back"
        if status & od.StatusBit.LOST
        else ""
    )


def commission(
    master: Master,
    module: int,
    interface: int | None,
    wishes: CommissionOptions,
    guard: Guard,
    steps: Steps,
    date: str,
) -> Result:
    """The command. ``interface`` None: read from the module; ``date`` as for :meth:`.Provenance.of_run`."""
    steps.step("reading the module")
    session = Session.open(master, module, interface)
    node = session.module
    if session.active.table is None:
        raise CommissioningError(
            f"{node.name}: no correction table is active, and the limits would have to include the "
            "errors of the encoder: run canfb calibrate first"
        )
    limits = SupervisionLimits.read(node)
    if wishes.write:
        check_unlocked(node)
    if wishes.save:
        check_can_save(node)
    check_valid(node)
    counters, began_s = read_counters(node), master.now()
    steps.step(f"listening to the machine for {wishes.seconds:g} s: let it do its normal duty")
    with without_restart(node):  # which sets limits and counters back
        samples, readings = _collect(session, wishes, steps)
        usual, usual_s = counted(counters, read_counters(node)), master.now() - began_s
    steps.step(f"calculating from {len(samples)} samples")
    observed = observe(samples, session.active, limits, readings)
    choices = choose(observed, limits, wishes.margin, wishes.acceleration)
    chosen = limits.changed({one.place: one.value for one in choices})
    before, new = (one.chain_limits(observed.interval_s) for one in (limits, chosen))
    _prove(observed, new)
    changes = [one for one in choices if one.changes]
    saved_as = None
    if wishes.write and changes:
        saved_as = set_limits(
            node,
            {one.place: one.before for one in changes},
            {one.place: one.value for one in changes},
            lambda: watch(node, wishes.watch_s, usual, usual_s, steps.part),
            guard,
            keep=wishes.save,
            step=steps.step,
        )
        steps.step(f"the limits are in force{', and saved' * (saved_as is not None)}")
    done = Commissioned(
        observed,
        before,
        new,
        limits.settings.coast_samples,
        choices,
        usual,
        wishes,
        bool(wishes.write and changes),
        saved_as,
        session.provenance(Provenance.of_run(date, wishes.line)),
    )
    paths = [write_page(wishes.out, done), keep_samples(wishes.out, observed.samples)] if wishes.out else []
    return findings(done).result(paths)


def _collect(
    session: Session, wishes: CommissionOptions, steps: Steps
) -> tuple[TrackSamples, list[SpeedReading]]:
    readings = SpeedReadings(session.module)
    if not wishes.recording:
        layout = replace(session.layout(), coarse=coarse_layout(session.module.read_known))
        samples = listen(session.master, layout, wishes.seconds, LEAST_SAMPLES, steps.part, readings)
        return samples, readings.found
    found: list[SpeedReading] = []

    def progress(part: float) -> None:
        steps.part(part)
        if part < UPLOAD_PART:  # the upload has not begun
            at = session.module.integer(*od.RECORDING_RECORDED, "I")
            speed = readings.read()
            if at:
                found.append(SpeedReading(at - 1.0, speed))

    return record(session.module, wishes.seconds, None, progress), found


def _prove(observed: Observation, new: ChainLimits) -> None:
    again = supervise(observed.samples, observed.used, new, observed.start_speed)
    before = observed.followed.flagged
    more = {name: count for name, count in again.flagged.items() if count > before.get(name, 0)}
    if more:
        raise CommissioningError(
            f"the limits would flag samples of this measurement ({in_words(more)}): set a larger "
            "--margin, and examine the outliers"
        )
