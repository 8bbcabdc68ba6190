"""``canfb calibrate`` from the first sample to the last file, over a bus or from a file."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np

from canfb.calibrate.artefacts import keep_samples, keep_speeds, write, write_refusal
from canfb.calibrate.calibration_summary import drift_result, findings, module_drift_result
from canfb.calibrate.choices import MODULE, PDO, CalibrateOptions
from canfb.calibrate.measurement import (
    InForce,
    Measurement,
    Settings,
    SpeedSamples,
    check_at_speed,
    measure,
    measure_speeds,
)
from canfb.calibrate.procedure import (
    Installation,
    accept,
    discard,
    install,
    let_check,
    let_measure,
    verify,
    verify_at_speed,
)
from canfb.calibration.deviation import Deviation
from canfb.calibration.path_fit import check_apart
from canfb.cia301 import cob
from canfb.errors import CalibrationError, CanfbError
from canfb.master.access import CommissioningError, Master, NodeAccess, Progress, received
from canfb.master.all_or_nothing import Guard, check_can_save, check_unlocked
from canfb.master.machine_watch import (
    LockWatch,
    Look,
    Meanwhile,
    Provenance,
    SpeedReadings,
    check_valid,
    look_at,
    lost_words,
)
from canfb.master.samples import TrackSamples
from canfb.master.session import Session, read_corners
from canfb.rows import Result
from canfb.sdo.tables import read_table
from canfb.signal.correction import NO_CORRECTION, Correction
from canfb.signal.limits import RPM
from canfb.signal.supervision import SampleLimits

Made = TypeVar("Made")
Installed = tuple[Measurement, Installation]


class Steps(Protocol):
    """Receives the progress; never raises."""

    def step(self, text: str) -> None:
        """A new step begins."""

    def part(self, part: float) -> None:
        """Progress of the step, 0..1."""


class CalibrationRun:
    """One run of the command with the options ``choices``.

    ``date`` is ISO 8601, with a space before the time. ``refused`` gets the error of a refused
    measurement before it is raised, after samples and report are written to ``choices.out``.
    """

    def __init__(
        self,
        choices: CalibrateOptions,
        steps: Steps,
        date: str,
        refused: Callable[[CalibrationError], None] = lambda error: None,
    ) -> None:
        self._where = Provenance.of_run(
            date,
            choices.line,
            encoder=choices.encoder,
            cycles_per_revolution=choices.cycles_per_revolution,
        )
        self._limits: SampleLimits | None = None
        self._choices = choices
        self._steps = steps
        self._refused = refused

    def from_file(self, path: Path) -> Result:
        """Calibrate from a file of samples, or a folder with one for each speed: writes only files."""
        choices, settings = self._choices, self._choices.settings(None)
        before = read_table(choices.table).used if choices.table else NO_CORRECTION
        if choices.speeds is not None:
            return self._report(
                self._measured_speeds(choices.samples_of_folder(path), settings, InForce(before))
            )
        return self._report(self._measured(choices.samples_of_file(path), before, settings))

    def over_bus(self, master: Master, module: int, interface: int | None, guard: Guard) -> Result:
        choices = self._choices
        self._steps.step("reading the active table")
        session = Session.open(master, module, interface)
        self._where = session.provenance(self._where)
        self._limits = session.limits
        if not (choices.check or choices.dry_run):
            check_unlocked(session.module)
        if choices.save:
            check_can_save(session.module)
        if choices.speeds is not None:
            return self._at_speeds(session, guard)
        if choices.check and choices.samples_from == PDO and session.path_is_known:
            return self._check_at_speed(session)
        settings = choices.settings(session.limits)
        source = session.source(choices.samples_from, choices.recorder, choices.sample_rate)

        def prove(found: Measurement) -> Deviation:
            fresh = source(choices.verify_s, choices.least_fresh, self._steps.part)
            return verify(session.together(fresh), found, settings)

        put = partial(self._install, session, guard, prove)
        if choices.samples_from == MODULE:
            return self._by_module(session, put, settings)
        watch = LockWatch(session.cycles_per_revolution, session.speed_rad_s)
        watched = session.source(choices.samples_from, choices.recorder, choices.sample_rate, watch)
        with self._observed(session.module):
            self._steps.step(f"collecting {choices.collecting}")
            samples = session.together(watched(choices.collect_s, choices.least_samples, self._steps.part))
        if watch.found is not None:
            self._judged(samples, watch.raise_found)
        return self._report(self._measured(samples, session.active, settings), put)

    @contextlib.contextmanager
    def _observed(self, module: NodeAccess) -> Iterator[None]:
        """Look at the module before and after; say what was lost."""
        before = self._look(module)
        with received(module.master, cob.ERROR_CONTROL + module.node_id) as heard:
            yield
        after = self._look(module, before)
        if cob.BOOT_UP in heard:  # its counters began again
            self._steps.step(
                f"{module.name} was restarted meanwhile (boot-up heard): the samples are right; what was not "
                "saved is lost"
            )
        elif before is not None and after is not None:
            self._where = replace(self._where, meanwhile=Meanwhile(before, after))

    def _look(self, module: NodeAccess, before: Look | None = None) -> Look | None:
        look = look_at(module)
        if look is not None and look.is_lost and not (before is not None and before.is_lost):
            self._steps.step(lost_words(module, look.status))
        return look

    def _by_module(
        self,
        session: Session,
        put: Callable[..., Installed],
        settings: Settings,
    ) -> Result:
        with self._observed(session.module):
            self._steps.step("the module measures")
            if self._choices.check:
                session.check_interface()
                drift = let_check(session.module, self._steps.part)
                return module_drift_result(drift, session.active, self._where)
            samples = session.together(let_measure(session.module, session.layout(), self._steps.part))
        with contextlib.ExitStack() as unless_accepted:
            unless_accepted.callback(discard, session.module)

            def accepted(measured: Measurement) -> Installed:
                installed = put(measured, lambda found: accept(session.module, found, settings))
                unless_accepted.pop_all()
                return installed

            return self._report(self._measured(samples, session.active, settings), accepted)

    def _measured(self, samples: TrackSamples, before: Correction, settings: Settings) -> Measurement:
        same = before.conditioning if self._choices.check else None
        return self._judged(samples, lambda: measure(samples, settings, before, self._steps.part, same))

    def _install(
        self,
        session: Session,
        guard: Guard,
        prove: Callable[[Measurement], Deviation],
        measured: Measurement,
        put: Callable[[Measurement], Measurement] | None = None,
    ) -> Installed:
        check_amplitude(measured, session.limits)
        return install(
            session.module,
            measured,
            prove,
            guard,
            put=put,
            keep=self._choices.save,
            step=self._steps.step,
        )

    def _collect(self, session: Session, seconds: float, least: int) -> SpeedSamples:
        readings = SpeedReadings(session.module)
        watch = LockWatch(session.cycles_per_revolution, session.speed_rad_s)
        source = session.source(
            PDO,
            self._choices.recorder,
            self._choices.sample_rate,
            lambda listener: watch(listener) or readings(listener),
        )
        samples = source(seconds, least, self._steps.part)
        if watch.found is not None:
            self._judged(samples, watch.raise_found)
        if not readings.found:
            raise CommissioningError(
                f"{session.module.name} did not report its speed (2011:07): set a longer --seconds"
            )
        rad_s = math.fsum(one.rad_per_s for one in readings.found) / len(readings.found)
        return SpeedSamples(samples, rad_s * session.cycles_per_revolution / (2.0 * math.pi))

    def _at_speeds(self, session: Session, guard: Guard) -> Result:
        choices, steps = self._choices, self._steps
        node, settings = session.module, choices.settings(session.limits)
        check_apart(session.cycles_per_revolution / 60.0 * np.array(choices.speeds_rpm))
        check_valid(node)
        before = InForce(session.active, read_corners(session.module))
        samples: list[SpeedSamples] = []
        left = list(choices.speeds_rpm)
        readings = SpeedReadings(node)
        with self._observed(node):
            while left:
                steps.step(f"waiting for the machine to turn steadily at {listed(left)} rpm")
                rpm = wait_for_speed(
                    node.master, lambda: readings.read() * RPM, left, choices.wait, steps.part
                )
                left.remove(rpm)
                steps.step(f"at {rpm:g} rpm: collecting {choices.collecting}")
                samples.append(self._collect(session, choices.collect_s, choices.least_samples))

        def prove(found: Measurement) -> Deviation:
            fresh = self._collect(session, choices.verify_s, choices.least_fresh)
            return verify_at_speed(fresh, found, settings)

        return self._report(
            self._measured_speeds(samples, settings, before), partial(self._install, session, guard, prove)
        )

    def _measured_speeds(
        self, samples: Sequence[SpeedSamples], settings: Settings, before: InForce
    ) -> Measurement:
        lowest = min(samples, key=lambda one: abs(one.hertz)).samples
        if self._choices.out is not None:
            keep_speeds(self._choices.out, samples)
        part, delay = self._steps.part, self._choices.delay_to_set
        return self._judged(lowest, lambda: measure_speeds(samples, settings, before, part, delay))

    def _check_at_speed(self, session: Session) -> Result:
        choices = self._choices
        with self._observed(session.module):
            self._steps.step(f"collecting {choices.collecting}")
            measured = self._collect(session, choices.collect_s, choices.least_samples)
        active, settings = (
            InForce(session.active, read_corners(session.module)),
            choices.settings(session.limits),
        )
        return self._report(
            self._judged(
                measured.samples, lambda: check_at_speed(measured, active, settings, self._steps.part)
            )
        )

    def _report(self, measured: Measurement, put: Callable[[Measurement], Installed] | None = None) -> Result:
        """Result of a check, or of a table, which ``put`` activates first unless in a dry run."""
        out = self._choices.out
        if self._choices.check:
            if out:
                keep_samples(out, measured.samples)
            return drift_result(measured, self._where)
        done = Installation()
        if put is not None and not self._choices.dry_run:
            measured, done = put(measured)
        paths = write(out, measured, done, self._where, self._limits) if out else []
        return findings(measured, done, self._where).result(paths)

    def _judged(self, samples: TrackSamples, act: Callable[[], Made]) -> Made:
        self._steps.step(f"calculating from {len(samples)} samples")
        try:
            return act()
        except CalibrationError as error:
            if out := self._choices.out:
                write_refusal(out, samples, error, self._where, self._limits)
            self._refused(error)
            raise
        except ValueError as error:
            raise CanfbError(f"{samples.origin}: {error}") from error


NEAR_PART = 0.1  # largest relative distance from a requested speed
STEADY_PART = 0.01  # largest relative range of the last readings of a steady speed
STEADY_RPM = 0.5
READINGS, EVERY_S = 5, 0.3


def wait_for_speed(
    master: Master,
    read_rpm: Callable[[], float],
    speeds_rpm: Sequence[float],
    longest_s: float,
    progress: Progress,
) -> float:
    """Wait until the machine turns steadily at one of ``speeds_rpm``, and return that, rpm.

    If none is negative, it may turn either way. ``progress`` gets the elapsed part of the time.
    CommissioningError, with the present speed, after ``longest_s`` seconds.
    """
    began, last = master.now(), list[float]()
    while True:
        last = [*last[1 - READINGS :], read_rpm()]
        found = _steady_at(last, speeds_rpm)
        if found is not None:
            return found
        passed_s = master.now() - began
        if passed_s > longest_s:
            raise CommissioningError(
                f"the machine did not turn steadily at {listed(speeds_rpm)} rpm within {longest_s:g} s; it "
                f"turns at {last[-1]:.4g} rpm, {min(last):.4g} to {max(last):.4g} lately: --wait, or other "
                "--speeds; if the speed ripples because no table is active, canfb calibrate first"
            )
        progress(passed_s / longest_s)
        master.wait(EVERY_S)


def _steady_at(last: Sequence[float], speeds_rpm: Sequence[float]) -> float | None:
    mean = math.fsum(last) / len(last)
    if len(last) < READINGS or max(last) - min(last) > max(STEADY_PART * abs(mean), STEADY_RPM):
        return None
    if min(speeds_rpm) > 0.0:
        mean = abs(mean)
    near = min(speeds_rpm, key=lambda rpm: abs(rpm - mean))
    return near if abs(near - mean) <= NEAR_PART * abs(near) else None


def listed(speeds_rpm: Sequence[float]) -> str:
    words = [f"{rpm:g}" for rpm in speeds_rpm]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


SPARE_AMPLITUDE = 0.05  # required distance from the limits, relative to the amplitude


def check_amplitude(measured: Measurement, limits: SampleLimits) -> None:
    """CommissioningError if the amplitude, corrected for a new low-pass, would exceed its limits."""
    if measured.over_speeds is None or not measured.over_speeds.after.corners.are_there:
        return
    s, c = measured.calibration.conditioning.apply(*measured.calibration.tracks)
    sizes = (s * s + c * c) ** 0.5
    low, high = float(sizes.min()), float(sizes.max())
    spare = SPARE_AMPLITUDE * (low + high) / 2.0
    if low - spare < limits.amplitude_low_counts or high + spare > limits.amplitude_high_counts:
        least, most = limits.amplitude_low_counts, limits.amplitude_high_counts
        raise CommissioningError(
            f"with the low-pass taken out the amplitude is {low:.0f} to {high:.0f} counts at every speed, "
            f"and the limits are {least:.0f} to {most:.0f} (2001:03, 2001:04): set them for standstill first"
        )
