"""``canfb interface CONFIG.yaml``: encoder interfaces with an ADC of this computer on a real bus."""

from __future__ import annotations

import argparse

from canfb.cli.options import Commands, add_command, bus_options
from canfb.cli.serving_options import add_serving_options, serve
from canfb.configuration import INTERFACES, load_config
from canfb.hosting.hosting import InterfaceHosting


def register(commands: Commands) -> None:
    """Add the command."""
    summary = "run the encoder interface of a configuration, with an ADC, on a bus"
    parser = add_command(commands, "interface", summary, interface)
    add_serving_options(parser, "log each EMCY as well")


def interface(options: argparse.Namespace) -> int:
    """Serve the interfaces until Ctrl-C, SIGTERM or SIGHUP.

    A program error in one of them ends the process for all, with exit code 1.
    """
    config = load_config(options.config, INTERFACES)
    serve(InterfaceHosting(config, bus_options(options, config.bus), verbose=options.verbose), options)
    return 0
