"""``canfb commission``: limits of the supervision from the machine's own motion, proposed and set."""

from __future__ import annotations

import argparse
from pathlib import Path

from canfb.bus.clocks import date_and_time
from canfb.cli.node_options import measured_nodes, say_result, sync_master
from canfb.cli.options import (
    JSON,
    MEASURED_NODES,
    RATE,
    TIMEOUT,
    Commands,
    add_bus_options,
    add_command,
    between,
    named_config,
    option,
)
from canfb.cli.printing import shown_progress
from canfb.commission.commission_run import CommissionOptions, commission as run
from canfb.errors import ConfigError
from canfb.files import prepare_folder


def register(commands: Commands) -> None:
    add_command(
        commands,
        "commission",
        commission,
        *MEASURED_NODES,
        option(
            "--write", action="store_true", help="write the limits; undone if the module then flags samples"
        ),
        option("--save", action="store_true", help="with --write: save them (1010h)"),
        option(
            "--seconds",
            type=float,
            within=between(0.1, 3600.0),
            default=60.0,
            metavar="S",
            help="how long to listen to the machine (60)",
        ),
        option(
            "--margin",
            type=float,
            within=between(1.2, 10.0),
            default=2.0,
            metavar="X",
            help="safety factor (2)",
        ),
        option(
            "--acceleration",
            type=float,
            within=between(0.0, 1e9),
            default=0.0,
            metavar="RAD_S2",
            help="acceleration of the machine that may not occur now, such as an emergency stop",
        ),
        option(
            "--watch",
            type=float,
            within=between(0.1, 3600.0),
            default=10.0,
            dest="watch_s",
            metavar="S",
            help="with --write: how long to watch the machine with the new limits (10)",
        ),
        option(
            "--source",
            choices=("pdo", "recording"),
            default="pdo",
            help="pdo: the ADC PDO on the bus (default); recording: object 2050h of the module",
        ),
        option("--out", type=Path, metavar="DIR", help="folder for report and samples"),
        JSON,
        RATE,
        TIMEOUT,
        add_bus_options,
        idle=[(["save"], "write", True, "only with --write, without which nothing is written")],
    )


def commission(options: argparse.Namespace) -> int:
    wishes, config = wishes_of(options), named_config(options)
    if wishes.out:
        prepare_folder(wishes.out, "commission")
    nodes = measured_nodes(options, config)  # reports wrong options before the bus is opened
    with (
        shown_progress(
            quiet=options.json, interrupted="limits that were not verified are unchanged"
        ) as progress,
        sync_master(options, config) as (master, guard),
    ):
        return say_result(options, run(master, *nodes, wishes, guard, progress, date_and_time()), progress)


def wishes_of(options: argparse.Namespace) -> CommissionOptions:
    if options.source == "recording" and options.encoder_interface is not None:
        raise ConfigError("--encoder-interface: not with --source recording, which is that of the module")
    return CommissionOptions(
        seconds=options.seconds,
        margin=options.margin,
        acceleration=options.acceleration,
        recording=options.source == "recording",
        write=options.write,
        save=options.save,
        watch_s=options.watch_s,
        out=options.out,
        line=getattr(options, "line", ""),
    )
