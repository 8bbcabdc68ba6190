"""``canfb run CONFIG.yaml``: feedback modules on a real bus."""

from __future__ import annotations

import argparse

from canfb.cli.options import Commands, add_command, bus_options
from canfb.cli.serving_options import add_serving_options, serve
from canfb.configuration import load_config
from canfb.hosting.hosting import Hosting


def register(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(commands, "run", "run the feedback modules of a configuration on a bus", run)
    add_serving_options(parser, "log single faults and each EMCY as well")


def run(options: argparse.Namespace) -> int:
    """Serve the modules until Ctrl-C, SIGTERM or SIGHUP.

    A program error in one of them ends the process for all, with exit code 1.
    """
    config = load_config(options.config)
    serve(Hosting(config, bus_options(options, config.bus), verbose=options.verbose), options)
    return 0
