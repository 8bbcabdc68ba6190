"""``canfb run CONFIG.yaml``: feedback modules on a real bus."""

from __future__ import annotations

import argparse
import contextlib

from canfb.bus.hosting import Hosting
from canfb.bus.readiness import Readiness
from canfb.bus.runner import ending_on_signals
from canfb.cli.log_printing import printed_as_json, printed_without_waiting
from canfb.cli.options import Commands, add_bus_options, add_command, add_ready_file, bus_options
from canfb.configuration import load_config


def register(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(commands, "run", "run the feedback modules of a configuration on a bus", run)
    parser.add_argument("config", metavar="CONFIG.yaml")
    parser.add_argument(
        "-v", "--verbose", action="store_true", help="log single faults and each EMCY as well"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object a line, for programs")
    add_ready_file(parser)
    add_bus_options(parser)


def run(options: argparse.Namespace) -> int:
    """Serve the modules until Ctrl-C, SIGTERM or SIGHUP.

    A program error in one of them ends the process for all, with exit code 1.
    """
    config = load_config(options.config)
    hosting = Hosting(config, bus_options(options, config.bus), verbose=options.verbose)
    with (
        printed_as_json() if options.json else contextlib.nullcontext(),
        printed_without_waiting(),
        Readiness(options.ready_file) as readiness,
        hosting,
        ending_on_signals(hosting.stop),
    ):
        hosting.run(readiness.ready, readiness.alive)
    return 0
