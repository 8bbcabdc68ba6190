"""``canfb calibrate`` from the first sample to the last file, over a bus or from a file."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

from canfb.calibrate import own_calibration
from canfb.calibrate.artefacts import keep_samples, write, write_refusal
from canfb.calibrate.calibration_summary import CalibrateResult, result
from canfb.calibrate.choices import MODULE, PDO, CalibrateOptions
from canfb.calibrate.drift_check import check, check_at_speed, drift_result, module_drift_result
from canfb.calibrate.measurement import Measurement, Settings, measure
from canfb.calibrate.procedure import Installation, install
from canfb.calibrate.samples_through_chain import InForce, SpeedSamples
from canfb.errors import CalibrationError
from canfb.master.access import CommissioningError, Master
from canfb.master.all_or_nothing import Guard, check_unlocked
from canfb.master.machine_watch import (
    LockWatch,
    Look,
    Meanwhile,
    Provenance,
    SpeedReadings,
    look_at,
    lost_words,
)
from canfb.master.samples import TrackSamples
from canfb.master.session import Session, Source
from canfb.sdo.table_file import read_table
from canfb.signal.correction import NO_CORRECTION, Correction
from canfb.signal.supervision import SampleLimits

LEAST_FRESH = 1500


class Steps(Protocol):
    """Receives the progress."""

    def step(self, text: str) -> None:
        """A new step begins."""

    def part(self, part: float) -> None:
        """So much of the step is done, 0..1."""

    def clear(self) -> None:
        """There is something else to say."""


class CalibrationRun:
    """One run of the command, which does what ``choices`` say.

    ``date`` is ISO 8601, the time of day behind a space. ``refused`` gets the error of a measurement that
    is refused, before it is raised; its samples and a report are in ``choices.out`` then.
    """

    def __init__(
        self,
        choices: CalibrateOptions,
        steps: Steps,
        date: str,
        refused: Callable[[CalibrationError], None] = lambda error: None,
    ) -> None:
        day, _, time = date.partition(" ")
        self._where = Provenance(
            day,
            encoder=choices.encoder,
            cycles_per_revolution=choices.cycles_per_revolution,
            time=time,
            version=version("canfb"),
            command=choices.line,
        )
        self._limits: SampleLimits | None = None
        self._choices = choices
        self._steps = steps
        self._refused = refused

    def from_file(self, path: Path) -> CalibrateResult:
        """Samples of a file: nothing but files can come of it."""
        choices = self._choices
        samples = choices.samples_of_file(path)
        before = read_table(choices.table) if choices.table else NO_CORRECTION
        settings = choices.settings(None)
        if choices.check:
            return self._drift(samples, before, settings)
        return self._report(self._measured(samples, before, settings), Installation())

    def over_bus(self, master: Master, module: int, interface: int | None, guard: Guard) -> CalibrateResult:
        """With the nodes of a bus; ``interface`` None if the module is to say it."""
        choices = self._choices
        session = self._begin(master, module, interface)
        if choices.check and choices.samples_from == PDO and session.path_is_known:
            return self._check_at_speed(session)
        before = self._look(session, None)
        settings = choices.settings(session.limits)
        source = session.source(choices.samples_from, choices.recorder, choices.rate)
        source = self._together(session, source)
        if choices.samples_from == MODULE:
            return self._by_module(session, source, settings, guard, before)
        self._steps.step(f"collecting samples for {choices.collect_s:g} s")
        watch = LockWatch(session.cycles_per_revolution, session.speed_rad_s)
        first = self._together(
            session, session.source(choices.samples_from, choices.recorder, choices.rate, watch)
        )
        samples = first(choices.collect_s, choices.least_samples, self._steps.part)
        self._look(session, before)
        if watch.found is not None:
            self._judged(samples, watch.raise_found)
        if choices.check:
            return self._drift(samples, session.active, settings)
        measured, done = self._measured(samples, session.active, settings), Installation()
        if not choices.dry_run:
            measured, done = self._install(session, measured, source, settings, guard)
        return self._report(measured, done)

    def _begin(self, master: Master, module: int, interface: int | None) -> Session:
        """Read both nodes."""
        self._steps.step("reading the active table")
        session = Session.open(master, module, interface)
        self._where = replace(
            self._where,
            module=session.module.node_id,
            encoder_interface=None if session.samples_itself else session.interface.node_id,
            cycles_per_revolution=session.cycles_per_revolution,
            identity=session.identity,
            interface_identity=session.interface_identity,
        )
        self._limits = session.limits
        if not (self._choices.check or self._choices.dry_run):
            check_unlocked(session.module)
        return session

    @staticmethod
    def _together(session: Session, source: Source) -> Source:
        """The same samples, the cosine at the instant of the sine."""
        return lambda seconds, least, progress: session.together(source(seconds, least, progress))

    def _look(self, session: Session, before: Look | None) -> Look | None:
        """The module now; said at once if its position is lost, and kept beside the look ``before``."""
        look = look_at(session.module)
        if look is not None and look.is_lost and not (before is not None and before.is_lost):
            self._steps.step(lost_words(session.module, look.status))
        if look is not None and before is not None:
            self._where = replace(self._where, meanwhile=Meanwhile(before, look))
        return look

    def _by_module(
        self, session: Session, source: Source, settings: Settings, guard: Guard, before: Look | None
    ) -> CalibrateResult:
        """The module measures; its samples on the bus are measured here as well, for figures and pictures."""
        self._steps.step("the module measures")
        if self._choices.check:
            session.check_interface()
            drift = own_calibration.let_check(session.module, self._steps.part)
            return module_drift_result(drift, session.active, self._where)
        samples = own_calibration.let_measure(session.module, session.layout(), self._steps.part)
        samples = session.together(samples)
        self._look(session, before)
        accepted = False

        def accept() -> Measurement:
            return own_calibration.accept(session.module, ours, settings)

        try:
            ours = measured = self._measured(samples, session.active, settings)
            done = Installation()
            if not self._choices.dry_run:
                measured, done = self._install(session, ours, source, settings, guard, accept)
            accepted = done.active
        finally:
            if not accepted:
                own_calibration.discard(session.module)
        return self._report(measured, done)

    def _measured(self, samples: TrackSamples, before: Correction, settings: Settings) -> Measurement:
        """Calibrate; what is refused leaves its samples and a report that shows why."""
        found: Measurement = self._judged(
            samples, lambda: measure(samples, settings, before, self._steps.part)
        )
        return found

    def _install(
        self,
        session: Session,
        measured: Measurement,
        source: Source,
        settings: Settings,
        guard: Guard,
        put: Callable[[], Measurement] | None = None,
    ) -> tuple[Measurement, Installation]:
        """Activate, verify, save."""
        choices, steps = self._choices, self._steps

        def collect() -> TrackSamples:
            return source(choices.verify_s, min(choices.least_samples, LEAST_FRESH), steps.part)

        return install(
            session.module,
            measured,
            collect,
            settings,
            guard,
            put=put,
            keep=not choices.no_save,
            step=steps.step,
        )

    def _collect(self, session: Session, seconds: float, least: int) -> SpeedSamples:
        """Samples of now, and the speed that the module says meanwhile."""
        readings = SpeedReadings(session.module)
        watch = LockWatch(session.cycles_per_revolution, session.speed_rad_s)
        source = session.source(
            PDO,
            self._choices.recorder,
            self._choices.rate,
            lambda listener: watch(listener) or readings(listener),
        )
        samples = source(seconds, least, self._steps.part)
        if watch.found is not None:
            self._judged(samples, watch.raise_found)
        if not readings.found:
            raise CommissioningError(
                f"{session.module.name} did not say its speed (2011:07): set a longer --seconds"
            )
        rad_s = math.fsum(one.rad_per_s for one in readings.found) / len(readings.found)
        return SpeedSamples(samples, rad_s * session.cycles_per_revolution / (2.0 * math.pi))

    def _check_at_speed(self, session: Session) -> CalibrateResult:
        """How far the encoder has moved away, whatever the analog path does at this speed."""
        choices = self._choices
        self._look(session, None)
        self._steps.step(f"collecting samples for {choices.collect_s:g} s")
        measured = self._collect(session, choices.collect_s, choices.least_samples)
        active, settings = InForce(session.active, session.corners), choices.settings(session.limits)
        found = self._judged(
            measured.samples, lambda: check_at_speed(measured, active, settings, self._steps.part)
        )
        if choices.out:
            keep_samples(choices.out, measured.samples)
        return drift_result(found, self._where)

    def _drift(self, samples: TrackSamples, active: Correction, settings: Settings) -> CalibrateResult:
        """How far the encoder has moved away from its table."""
        found = self._judged(samples, lambda: check(samples, active, settings, self._steps.part))
        if self._choices.out:
            keep_samples(self._choices.out, samples)
        return drift_result(found, self._where)

    def _report(self, measured: Measurement, done: Installation) -> CalibrateResult:
        """What came out; the files are written."""
        out = self._choices.out
        paths = write(out, measured, done, self._where, self._limits) if out else []
        return result(measured, done, self._where, paths)

    def _judged(self, samples: TrackSamples, act: Callable[[], Any]) -> Any:
        """What ``act`` makes of the samples; what it refuses leaves its samples and a report."""
        self._steps.step(f"calculating from {len(samples)} samples")
        try:
            found = act()
        except CalibrationError as error:
            out = self._choices.out
            if out:
                write_refusal(out, samples, error, self._where, self._limits)
            self._refused(error)
            raise
        finally:
            self._steps.clear()
        return found
