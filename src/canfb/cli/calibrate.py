"""``canfb calibrate``: a reference measurement over the bus, its table proven, active and saved."""

from __future__ import annotations

import argparse
import json
from dataclasses import fields
from functools import partial
from pathlib import Path

from canfb.bus.clocks import date_and_time
from canfb.calibrate.artefacts import prepare
from canfb.calibrate.calibration_run import CalibrationRun, SpeedRun
from canfb.calibrate.choices import (
    LEAST_SAMPLES,
    MODULE,
    PDO,
    RECORDING,
    CalibrateOptions,
    refuse_combinations,
)
from canfb.calibrate.measurement import MOTION, ZERO_CROSSINGS
from canfb.cli.node_options import nodes_of, say_result, sync_master
from canfb.cli.options import (
    BUS_WORDS,
    Commands,
    add_answer_within,
    add_bus_options,
    add_command,
    add_measured_nodes,
    bus_options,
    named_config,
    refuse_idle,
)
from canfb.cli.progress import Progress, shown_progress
from canfb.cli.recording_options import add_columns
from canfb.configuration import Config
from canfb.errors import CalibrationError
from canfb.master.access import Master
from canfb.master.all_or_nothing import Guard
from canfb.rows import Result


def register(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(commands, "calibrate", calibrate)
    _add_nodes_and_results(parser)
    _add_measurement(parser)
    _add_speeds(parser)
    _add_file(parser)
    add_bus_options(parser)


def calibrate(options: argparse.Namespace) -> int:
    """Do all of it; 0 when the table is active, or when ``--dry-run`` or ``--check`` is done."""
    choices = choices_of(options)
    config = named_config(options)
    if choices.out:
        prepare(choices.out)
    with shown_progress(quiet=options.json, interrupted="the module is unchanged") as progress:
        if choices.samples:
            run = _run(choices, options, progress, date_and_time())
            return _say(run.from_file(choices.samples), options, progress)
        choices.nodes(nodes_of(config))  # says what cannot be before there is a bus
        words = bus_options(options, config.bus)
        guard = Guard()
        with sync_master(words, choices.sync, choices.answer_within, guard) as master:
            return over_bus(master, options, config, progress, guard, date_and_time())


def over_bus(
    master: Master, options: argparse.Namespace, config: Config, progress: Progress, guard: Guard, date: str
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


def _add_nodes_and_results(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "config",
        metavar="CONFIG.yaml",
        nargs="?",
        help="take the bus and the node-IDs of the first module from this file",
    )
    add_measured_nodes(parser)
    parser.add_argument("--dry-run", action="store_true", help="measure only, write nothing to the module")
    parser.add_argument(
        "--check", action="store_true", help="only measure how far the encoder has drifted from its table"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for table, samples and report")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parser.add_argument("--no-save", action="store_true", help="do not save (1010h): lost at a restart")


def _add_measurement(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("measurement")
    group.add_argument(
        "--method",
        choices=(MOTION, ZERO_CROSSINGS),
        default=MOTION,
        help="motion (default): any speed, one sample per SYNC; zero-crossings: slow, many samples per cycle",
    )
    group.add_argument(
        "--source",
        choices=(PDO, RECORDING, MODULE),
        help="pdo: the ADC PDO on the bus (default); recording: object 2050h (default of zero-crossings); "
        "module: the module calibrates itself (2030h)",
    )
    group.add_argument(
        "--recorder",
        choices=("interface", "module"),
        default="interface",
        help="node whose object 2050h records (default: interface)",
    )
    group.add_argument(
        "--seconds",
        type=float,
        metavar="S",
        help="duration of the measurement (20; 4 for a recording, 10 for a speed)",
    )
    group.add_argument(
        "--least-samples",
        type=int,
        default=LEAST_SAMPLES,
        metavar="N",
        help=f"minimum number of samples; measure up to six times longer to reach it ({LEAST_SAMPLES})",
    )
    group.add_argument(
        "--verify", type=float, metavar="S", help="duration of the verification (4; 1 for a recording)"
    )
    group.add_argument(
        "--conditioning",
        choices=("fit", "none"),
        default="fit",
        help="fit offset, gain and phase error of the tracks first (default), or correct all by the table",
    )
    group.add_argument("--entries", type=int, default=1024, metavar="N", help="length of the table (1024)")
    group.add_argument("--adc-bits", type=int, metavar="N", help="bits of the converter (from 2001:02)")
    group.add_argument("--rate", type=float, metavar="HZ", help="samples per second, if not known otherwise")
    group.add_argument("--sync", type=float, metavar="HZ", help="produce the SYNC, on a bus without one")
    group.add_argument("--encoder", default="", metavar="NAME", help="name or serial number of the encoder")
    add_answer_within(group)


def choices_of(options: argparse.Namespace) -> CalibrateOptions:
    """The options, checked. ConfigError for those that cannot be, alone or together."""
    names = [field.name for field in fields(CalibrateOptions) if hasattr(options, field.name)]
    choices = CalibrateOptions(**{name: getattr(options, name) for name in names})
    refuse_combinations(choices, partial(refuse_idle, options), (*BUS_WORDS, "bus_kwargs"))
    choices.refuse_impossible()
    return choices


def _add_speeds(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("several speeds (the analog path)")
    group.add_argument(
        "--speeds",
        metavar="RPM,RPM,...",
        help="measure at each of these speeds, in any order, as soon as the machine turns steadily at it; "
        'with --samples DIR: the speeds of its files in their order, or "recorded"',
    )
    group.add_argument(
        "--delay",
        metavar="estimate|S",
        help="write the delay of the analog path (2002:07): as estimated, or so many seconds (as it is)",
    )
    group.add_argument(
        "--wait",
        type=float,
        default=120.0,
        metavar="S",
        help="how long to wait for the machine to turn at the next speed (120)",
    )


def _add_file(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("samples of a file (no bus is used)")
    group.add_argument(
        "--samples",
        type=Path,
        metavar="FILE",
        help="NPZ file, or CSV with a header line; with --speeds a folder of them",
    )
    add_columns(group)
    group.add_argument(
        "--table", type=Path, metavar="FILE", help="the active table, YAML or bytes of 2020:01"
    )
    group.add_argument(
        "--cycles-per-revolution", type=int, metavar="N", help="also give errors as angles of the shaft"
    )
