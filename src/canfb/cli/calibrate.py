"""``canfb calibrate``: a reference measurement over the bus, its table proven, active and saved."""

from __future__ import annotations

import argparse
import json

from canfb.bus.clocks import date_and_time
from canfb.calibrate.artefacts import prepare
from canfb.calibrate.calibration_run import CalibrationRun
from canfb.calibrate.choices import CalibrateOptions
from canfb.calibrate.speed_run import SpeedRun
from canfb.cli.calibrate_options import add_options, choices_of
from canfb.cli.configured_nodes import nodes_of
from canfb.cli.node_options import say_result, sync_master
from canfb.cli.options import Commands, add_command, bus_options
from canfb.cli.printing import report
from canfb.cli.progress import Progress
from canfb.configuration import Config, load_config
from canfb.errors import CalibrationError
from canfb.master.access import Master
from canfb.master.all_or_nothing import Guard
from canfb.rows import Result


def register(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "calibrate",
        "measure the encoder, build its correction table, activate it and save it",
        calibrate,
    )
    add_options(parser)


def calibrate(options: argparse.Namespace) -> int:
    """Do all of it; 0 when the table is active, or when ``--dry-run`` or ``--check`` is done."""
    choices = choices_of(options)
    config = load_config(options.config) if options.config else Config()
    progress = Progress(quiet=options.json)
    if choices.out:
        prepare(choices.out)
    try:
        if choices.samples:
            run = _run(choices, options, progress, date_and_time())
            return _say(run.from_file(choices.samples), options, progress)
        choices.nodes(nodes_of(config))  # says what cannot be before there is a bus
        words = bus_options(options, config.bus)
        guard = Guard()
        with sync_master(words, choices.sync, choices.answer_within, guard) as master:
            return over_bus(master, options, config, progress, guard, date_and_time())
    except KeyboardInterrupt:
        progress.clear()
        report("interrupted; the module is unchanged")
        raise
    finally:
        progress.clear()


def over_bus(
    master: Master,
    options: argparse.Namespace,
    config: Config,
    progress: Progress,
    guard: Guard,
    date: str,
) -> int:
    """The command on an open bus; the exit code. ``date`` is ISO 8601, the time of day behind a space."""
    choices = choices_of(options)
    run = _run(choices, options, progress, date)
    return _say(run.over_bus(master, *choices.nodes(nodes_of(config)), guard), options, progress)


def _run(
    choices: CalibrateOptions, options: argparse.Namespace, progress: Progress, date: str
) -> CalibrationRun:
    def refused(error: CalibrationError) -> None:
        if options.json:
            refusal = {"accepted": False, "reason": error.reason, "message": str(error)}
            print(json.dumps(refusal | {"active": False, "saved": False}, indent=2))

    kind = CalibrationRun if choices.speeds is None else SpeedRun
    return kind(choices, progress, date, refused)


def _say(result: Result, options: argparse.Namespace, progress: Progress) -> int:
    progress.clear()
    return say_result(options, result)
