"""``canfb calibrate``: a reference measurement over the bus; its table is verified, activated and saved."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import fields
from functools import partial
from pathlib import Path

from canfb.bus.clocks import date_and_time
from canfb.calibrate.artefacts import SPEEDS, TABLE_YAML
from canfb.calibrate.calibration_run import CalibrationRun
from canfb.calibrate.choices import (
    IDLE,
    LEAST_SAMPLES,
    MODULE,
    OF_CSV,
    PDO,
    RECORDING,
    WITHOUT_BUS,
    CalibrateOptions,
)
from canfb.calibrate.measurement import MOTION, ZERO_CROSSINGS
from canfb.cli.node_options import measured_nodes, say_result, sync_master
from canfb.cli.options import (
    BUS_WORDS,
    COLUMNS,
    JSON,
    MEASURED_NODES,
    RATE,
    TIMEOUT,
    Commands,
    add_bus_options,
    add_command,
    between,
    group,
    named_config,
    option,
    refuse_idle,
)
from canfb.cli.printing import Progress, shown_progress
from canfb.errors import CalibrationError
from canfb.files import REPORT, prepare_folder
from canfb.rows import Result


def register(commands: Commands) -> None:
    add_command(
        commands,
        "calibrate",
        calibrate,
        *MEASURED_NODES,
        option("--dry-run", action="store_true", help="measure only, write nothing to the module"),
        option(
            "--check", action="store_true", help="only measure how far the encoder has drifted from its table"
        ),
        option("--out", type=Path, metavar="DIR", help="folder for table, samples and report"),
        JSON,
        option("--save", action="store_true", help="save the table (1010h); else a restart loses it"),
        group(
            "measurement",
            option(
                "--method",
                choices=(MOTION, ZERO_CROSSINGS),
                default=MOTION,
                help="motion (default): any speed, one sample per SYNC; zero-crossings: slow, many per cycle",
            ),
            option(
                "--source",
                choices=(PDO, RECORDING, MODULE),
                help="pdo: the ADC PDO on the bus (default); recording: object 2050h (zero-crossings); "
                "module: the module calibrates itself (2030h)",
            ),
            option(
                "--recorder",
                choices=("interface", "module"),
                default="interface",
                help="node whose object 2050h records (default: interface)",
            ),
            option(
                "--seconds",
                type=float,
                within=between(0.1, 3600.0),
                metavar="S",
                help="duration of the measurement (20; 4 for a recording, 10 for a speed)",
            ),
            option(
                "--least-samples",
                type=int,
                within=between(0, 10_000_000),
                default=LEAST_SAMPLES,
                metavar="N",
                help=f"least number of samples; measured up to six times longer if needed ({LEAST_SAMPLES})",
            ),
            option(
                "--verify",
                type=float,
                within=between(0.1, 600.0),
                metavar="S",
                help="duration of the verification (4; 1 for a recording)",
            ),
            option(
                "--conditioning",
                choices=("fit", "none"),
                default="fit",
                help="fit offset, gain and phase error first (default), or leave all to the table",
            ),
            option(
                "--entries",
                type=int,
                within=between(16, 4096),
                default=1024,
                metavar="N",
                help="length of the table (1024)",
            ),
            option(
                "--adc-bits",
                type=int,
                within=between(4, 16),
                metavar="N",
                help="bits of the converter (from 2001:02)",
            ),
            option(
                "--sample-rate",
                type=float,
                within=between(0.1, 1e7),
                metavar="HZ",
                help="samples per second, if not known otherwise",
            ),
            RATE,
            option("--encoder", default="", metavar="NAME", help="name or serial number of the encoder"),
            TIMEOUT,
        ),
        group(
            "several speeds (the analog path)",
            option(
                "--speeds",
                metavar="RPM,RPM,...",
                help="measure at each of these speeds, in any order, as soon as the machine turns at it; "
                'with --samples DIR: the speeds of its files in their order, or "recorded"',
            ),
            option(
                "--delay",
                metavar="estimate|S",
                help="write the delay of the analog path (2002:07): as estimated, or in seconds (unchanged)",
            ),
            option(
                "--wait",
                type=float,
                within=between(1.0, 86400.0),
                default=120.0,
                metavar="S",
                help="how long to wait for the machine to turn at the next speed (120)",
            ),
        ),
        group(
            "samples of a file (no bus is used)",
            option(
                "--samples",
                type=Path,
                metavar="FILE",
                help="NPZ file, or CSV with a header line; with --speeds a folder of them",
            ),
            *COLUMNS,
            option("--table", type=Path, metavar="FILE", help="the active table, YAML or bytes of 2020:01"),
            option(
                "--cycles-per-revolution",
                type=int,
                within=between(1, 1 << 20),
                metavar="N",
                help="also give errors as angles of the shaft",
            ),
        ),
        add_bus_options,
        idle=[*IDLE, ((*BUS_WORDS, "bus_kwargs"), "samples", False, WITHOUT_BUS)],
    )


def calibrate(options: argparse.Namespace) -> int:
    choices = choices_of(options)
    config = named_config(options)
    if choices.out:
        # Beside new samples they would pass for theirs.
        kept = [TABLE_YAML, REPORT] * choices.check + [SPEEDS] * (choices.speeds is None)
        prepare_folder(choices.out, "calibrate", *kept)
    with shown_progress(quiet=options.json, interrupted="nothing more is written to the module") as progress:
        if choices.samples:
            return measured(
                options, progress, date_and_time(), partial(CalibrationRun.from_file, path=choices.samples)
            )
        nodes = measured_nodes(options, config)  # reports wrong options before the bus is opened
        with sync_master(options, config) as (master, guard):
            return measured(
                options, progress, date_and_time(), lambda run: run.over_bus(master, *nodes, guard)
            )


def measured(
    options: argparse.Namespace, progress: Progress, date: str, measure: Callable[[CalibrationRun], Result]
) -> int:
    """Print the result of ``measure``; returns the exit code. ``date``: ISO 8601, a space before the time."""

    def refused(error: CalibrationError) -> None:
        if options.json:
            refusal = {"accepted": False, "reason": error.reason, "message": str(error)}
            print(json.dumps(refusal | {"active": False, "saved": False}, indent=2))

    return say_result(
        options, measure(CalibrationRun(choices_of(options), progress, date, refused)), progress
    )


def choices_of(options: argparse.Namespace) -> CalibrateOptions:
    names = (field.name for field in fields(CalibrateOptions))
    choices = CalibrateOptions(**{name: getattr(options, name) for name in names if hasattr(options, name)})
    if choices.samples is not None and choices.samples.suffix.lower() == ".npz":
        refuse_idle(options, OF_CSV, f"only for CSV, not for {choices.samples.name}")
    return choices
