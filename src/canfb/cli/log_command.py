"""``canfb log record FILE``: a log of the bus, in the formats of python-can; ``canfb log replay``."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from canfb.bus.opening import describe, open_bus
from canfb.bus.runner import ending_on_signals
from canfb.cli import replay
from canfb.cli.options import (
    Commands,
    add_bus_options,
    add_command,
    add_group,
    add_options,
    add_ready_file,
    chosen_bus,
    option,
)
from canfb.cli.printing import say
from canfb.cli.subjects import positive
from canfb.hosting.readiness import Readiness
from canfb.logfile.bus_log import BusLog

UNITS = {"": 1, "k": 10**3, "M": 10**6, "G": 10**9}


def register(commands: Commands) -> None:
    """Add the commands."""
    parts = add_group(commands, "log")
    replay.add_to(parts)
    parser = add_command(parts, "record", record, "write a log of the bus")
    add_options(
        parser,
        option(
            "file",
            metavar="FILE",
            type=Path,
            help="the suffix says which format: .log (candump), .asc, .blf, ...",
        ),
        option("--config", metavar="CONFIG.yaml", help="takes the bus from this configuration"),
        option("--seconds", type=positive, metavar="S", help="how long (default: until Ctrl-C)"),
        option(
            "--max-size",
            type=_size,
            default=0,
            metavar="BYTES",
            help="begin another file at this size (500k, 100M, 2G); the full one is renamed",
        ),
        option("--force", action="store_true", help="overwrite a file that is there"),
    )
    add_ready_file(parser)
    add_bus_options(parser)


def _size(text: str) -> int:
    found = re.fullmatch(r"([1-9][0-9]{0,11})([kMG]?)B?", text)
    if found is None:
        raise argparse.ArgumentTypeError(f"{text!r} is no size; write it as 500k, 100M or 2G")
    return int(found[1]) * UNITS[found[2]]


def record(options: argparse.Namespace) -> int:
    """Record until Ctrl-C, SIGTERM, SIGHUP or --seconds."""
    words = chosen_bus(options)
    bus_log = BusLog(options.file, options.max_size, options.force)
    with (
        Readiness(options.ready_file) as readiness,
        open_bus(words) as bus,
        bus_log,
        ending_on_signals(bus_log.stop),
    ):
        say(f"recording {describe(words)} to {options.file}; end with Ctrl-C")
        readiness.ready()
        bus_log.record(bus, options.seconds)
    errors = f", {bus_log.error_frames} of them error frames" if bus_log.error_frames else ""
    say(f"{bus_log.frames} frames{errors}")
    return 0
