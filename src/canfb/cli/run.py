"""``canfb run CONFIG.yaml`` and ``canfb interface CONFIG.yaml``: the nodes of a configuration on a real bus.

``run`` serves feedback modules, ``interface`` encoder interfaces with an ADC of this computer. A program
error in one of the nodes ends the process for all, with exit code 1.
"""

from __future__ import annotations

import argparse
import contextlib

from canfb.bus.runner import ending_on_signals
from canfb.cli.options import Commands, add_bus_options, add_command, add_ready_file, bus_options
from canfb.cli.printing import printed_as_json, printed_without_waiting
from canfb.configuration import INTERFACES, load_config
from canfb.hosting.hosting import Hosting, InterfaceHosting
from canfb.hosting.readiness import Readiness
from canfb.hosting.self_diagnosis import diagnosing_on_signal
from canfb.hosting.serving import Serving


def register(commands: Commands) -> None:
    """Add both commands."""
    modules = add_command(commands, "run", run)
    interfaces = add_command(commands, "interface", interface)
    for parser, verbose in (
        (modules, "log single faults and each EMCY as well"),
        (interfaces, "log each EMCY as well"),
    ):
        parser.add_argument("config", metavar="CONFIG.yaml")
        parser.add_argument("-v", "--verbose", action="store_true", help=verbose)
        parser.add_argument("--json", action="store_true", help="print one JSON object a line, for programs")
        add_ready_file(parser)
        add_bus_options(parser)


def run(options: argparse.Namespace) -> int:
    """Serve the modules."""
    config = load_config(options.config)
    return _serve(Hosting(config, bus_options(options, config.bus), verbose=options.verbose), options)


def interface(options: argparse.Namespace) -> int:
    """Serve the interfaces."""
    config = load_config(options.config, INTERFACES)
    return _serve(
        InterfaceHosting(config, bus_options(options, config.bus), verbose=options.verbose), options
    )


def _serve(serving: Serving, options: argparse.Namespace) -> int:
    """Until Ctrl-C, SIGTERM or SIGHUP; SIGUSR1 writes a diagnosis."""
    with (
        printed_as_json() if options.json else contextlib.nullcontext(),
        printed_without_waiting(),
        Readiness(options.ready_file) as readiness,
        serving,
        ending_on_signals(serving.stop),
        diagnosing_on_signal(serving.diagnose),
    ):
        serving.run(readiness.ready, readiness.alive)
    return 0
