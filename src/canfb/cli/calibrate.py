"""``canfb calibrate``: a reference measurement over the bus, its table proven, active and saved."""

from __future__ import annotations

import argparse
import contextlib
import json
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import can

from canfb.bus.master import BusMaster
from canfb.bus.opening import open_bus
from canfb.bus.runner import ending_on_signals
from canfb.bus.wall_clock import date_and_time
from canfb.cli.calibrate_options import (
    MODULE,
    add_options,
    check_options,
    chosen_nodes,
    samples_of_file,
    settings_of,
)
from canfb.cli.options import Commands, add_command, bus_options, report
from canfb.cli.progress import Progress
from canfb.commissioning import own_calibration
from canfb.commissioning.access import Master
from canfb.commissioning.active import NOTHING_ACTIVE, ActiveSet
from canfb.commissioning.artefacts import keep_samples, prepare, write, write_refusal
from canfb.commissioning.drift_check import (
    check,
    drift_json,
    drift_lines,
    module_drift_json,
    module_drift_lines,
)
from canfb.commissioning.lock import LockWatch
from canfb.commissioning.procedure import Guard, Installation, Measurement, Settings, install, measure
from canfb.commissioning.samples import Samples
from canfb.commissioning.session import Session, Source
from canfb.commissioning.summary import Circumstances, as_json, comparison, facts, outcome, verdict
from canfb.commissioning.table_file import read_table
from canfb.configuration import Config, load_config
from canfb.errors import BusError, CalibrationError
from canfb.signal.supervision import SampleLimits

LEAST_FRESH = 1500


def register(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "calibrate",
        "measure the encoder, build its correction table, put it in force and save it",
        calibrate,
    )
    add_options(parser)


def calibrate(options: argparse.Namespace) -> int:
    """Do all of it; 0 when the table is in force, or when ``--dry-run`` or ``--check`` is done."""
    check_options(options)
    config = load_config(options.config) if options.config else Config()
    progress = Progress(quiet=options.json)
    if options.out:
        prepare(options.out)
    try:
        if options.samples:
            return _Job(options, progress, date_and_time()).from_file()
        chosen_nodes(options, config)  # says what cannot be before there is a bus
        words = bus_options(options, config.bus)
        guard = Guard()
        bus = _open(words, hears_itself=options.sync is not None)
        with BusMaster(bus, options.answer_within) as master, ending_on_signals(guard.interrupt):
            if options.sync is not None:
                master.produce_sync(options.sync)
            return over_bus(master, options, config, progress, guard, date_and_time())
    except KeyboardInterrupt:
        progress.clear()
        report("interrupted; the module is as it was")
        raise
    finally:
        progress.clear()


def _open(words: dict[str, Any], hears_itself: bool) -> can.BusABC:
    """The bus; one that ``hears_itself`` if it can be told to, because samples are counted by the SYNC."""
    if hears_itself:
        with contextlib.suppress(BusError):  # udp_multicast always does, and cannot be told
            return open_bus(words | {"receive_own_messages": True})
    return open_bus(words)


def over_bus(
    master: Master,
    options: argparse.Namespace,
    config: Config,
    progress: Progress,
    guard: Guard,
    date: str,
) -> int:
    """The command on an open bus; the exit code. ``date`` is ISO 8601, the time of day behind a space."""
    progress.step("reading what is active")
    session = Session.open(master, *chosen_nodes(options, config))
    job = _Job(options, progress, date)
    job.where = replace(
        job.where,
        module=session.module.node_id,
        encoder_interface=None if session.samples_itself else session.interface.node_id,
        cycles_per_revolution=session.cycles_per_revolution,
        identity=session.identity,
        interface_identity=session.interface_identity,
    )
    job.limits = session.limits
    settings = settings_of(options, session.limits)
    source = session.source(options.source, options.recorder, options.rate)
    if options.source == MODULE:
        return _by_module(session, job, source, settings, guard)
    progress.step(f"collecting samples for {options.seconds:g} s")
    watch = LockWatch(session.cycles_per_revolution, session.speed_rad_s)
    first = session.source(options.source, options.recorder, options.rate, watch)
    samples = first(options.seconds, options.least_samples, progress.part)
    if watch.found is not None:
        job.judged(samples, watch.raise_found)
    if options.check:
        return job.report_drift(samples, session.active, settings)
    measured, done = job.measured(samples, session.active, settings), Installation()
    if not options.dry_run:
        measured, done = job.install(session, measured, source, settings, guard)
    return job.report(measured, done)


def _by_module(session: Session, job: _Job, source: Source, settings: Settings, guard: Guard) -> int:
    """The module measures; what it hears is measured here as well, for the figures and the pictures."""
    job.progress.step("the module measures")
    if job.options.check:
        session.check_interface()
        drift = own_calibration.let_check(session.module, job.progress.part)
        return job.say(
            module_drift_json(drift, session.active, job.where),
            module_drift_lines(drift, session.active, job.where),
        )
    samples = own_calibration.let_measure(session.module, session.layout(), job.progress.part)
    accepted = False

    def accept() -> Measurement:
        return own_calibration.accept(session.module, ours, settings)

    try:
        ours = measured = job.measured(samples, session.active, settings)
        done = Installation()
        if not job.options.dry_run:
            measured, done = job.install(session, ours, source, settings, guard, accept)
        accepted = done.active
    finally:
        if not accepted:
            own_calibration.discard(session.module)
    return job.report(measured, done)


class _Job:
    """What does not depend on where the samples come from."""

    def __init__(self, options: argparse.Namespace, progress: Progress, date: str) -> None:
        day, _, time = date.partition(" ")
        self.where = Circumstances(
            day,
            encoder=options.encoder,
            cycles_per_revolution=options.cycles_per_revolution,
            time=time,
            version=version("canfb"),
            command=getattr(options, "line", ""),
        )
        self.limits: SampleLimits | None = None
        self.options = options
        self.progress = progress

    def from_file(self) -> int:
        """Samples of a file: nothing but files can come of it."""
        options = self.options
        samples = samples_of_file(options)
        before = read_table(options.table) if options.table else NOTHING_ACTIVE
        settings = settings_of(options, None)
        if options.check:
            return self.report_drift(samples, before, settings)
        return self.report(self.measured(samples, before, settings), Installation())

    def measured(self, samples: Samples, before: ActiveSet, settings: Settings) -> Measurement:
        """Calibrate; what is refused leaves its samples and a report that shows why."""
        found: Measurement = self.judged(
            samples, lambda: measure(samples, settings, before, self.progress.part)
        )
        return found

    def install(
        self,
        session: Session,
        measured: Measurement,
        source: Source,
        settings: Settings,
        guard: Guard,
        put: Callable[[], Measurement] | None = None,
    ) -> tuple[Measurement, Installation]:
        """Put in force, prove, save."""
        options, progress = self.options, self.progress

        def collect() -> Samples:
            return source(options.verify, min(options.least_samples, LEAST_FRESH), progress.part)

        return install(
            session.module,
            measured,
            collect,
            settings,
            guard,
            put=put,
            keep=not options.no_save,
            step=progress.step,
        )

    def report_drift(self, samples: Samples, active: ActiveSet, settings: Settings) -> int:
        """How far the encoder has moved away from its table."""
        found = self.judged(samples, lambda: check(samples, active, settings, self.progress.part))
        if self.options.out:
            keep_samples(self.options.out, samples)
        return self.say(drift_json(found, self.where), drift_lines(found, self.where))

    def report(self, measured: Measurement, done: Installation) -> int:
        """Say what came out, and write the files."""
        out = self.options.out
        paths = write(out, measured, done, self.where, self.limits) if out else []
        figures = as_json(measured, done, self.where) | {"files": [str(path) for path in paths]}
        return self.say(figures, account(measured, done, self.where, paths))

    def say(self, figures: dict[str, Any], lines: list[str]) -> int:
        """On standard output, for programs or for people."""
        self.progress.clear()
        print(json.dumps(figures, indent=2) if self.options.json else "\n".join(lines))
        return 0

    def judged(self, samples: Samples, act: Callable[[], Any]) -> Any:
        """What ``act`` makes of the samples; what it refuses leaves its samples and a report."""
        self.progress.step(f"calculating from {len(samples)} samples")
        try:
            result = act()
        except CalibrationError as error:
            out = self.options.out
            if out:
                write_refusal(out, samples, error, self.where, self.limits)
            if self.options.json:
                refusal = {"accepted": False, "reason": error.reason, "message": str(error)}
                print(json.dumps(refusal | {"active": False, "saved": False}, indent=2))
            raise
        finally:
            self.progress.clear()
        return result


def account(measured: Measurement, done: Installation, where: Circumstances, paths: list[Path]) -> list[str]:
    """The account for people."""
    rows = comparison(measured, done, where)
    wide = max(len(row.before) for row in rows)
    lines = [f"{'':24}{'before':{wide}}  after"]
    lines += [f"{row.name:24}{row.before:{wide}}  {row.after}" for row in rows]
    lines.append("")
    lines += [f"{name:24}{text}" for name, text in facts(measured, done, where)]
    lines += ["", verdict(measured), outcome(measured, done, where)]
    lines += [f"written  {path}" for path in paths]
    return lines
