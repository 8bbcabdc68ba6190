"""``canfb run`` and ``canfb interface``: their common options, and nodes that are served until the end."""

from __future__ import annotations

import argparse
import contextlib

from canfb.bus.runner import ending_on_signals
from canfb.cli.log_printing import printed_as_json, printed_without_waiting
from canfb.cli.options import add_bus_options, add_ready_file
from canfb.hosting.readiness import Readiness
from canfb.hosting.self_diagnosis import diagnosing_on_signal
from canfb.hosting.serving import Serving


def add_serving_options(parser: argparse.ArgumentParser, verbose: str) -> None:
    """The configuration, what is printed, readiness, the bus; ``verbose`` says what -v logs."""
    parser.add_argument("config", metavar="CONFIG.yaml")
    parser.add_argument("-v", "--verbose", action="store_true", help=verbose)
    parser.add_argument("--json", action="store_true", help="print one JSON object a line, for programs")
    add_ready_file(parser)
    add_bus_options(parser)


def serve(serving: Serving, options: argparse.Namespace) -> None:
    """Serve the nodes until Ctrl-C, SIGTERM or SIGHUP; SIGUSR1 writes a diagnosis."""
    with (
        printed_as_json() if options.json else contextlib.nullcontext(),
        printed_without_waiting(),
        Readiness(options.ready_file) as readiness,
        serving,
        ending_on_signals(serving.stop),
        diagnosing_on_signal(serving.diagnose),
    ):
        serving.run(readiness.ready, readiness.alive)
