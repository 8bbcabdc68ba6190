"""``canfb run CONFIG.yaml``: the modules and encoder interfaces of a configuration on a real bus."""

import argparse

from canfb.bus.runner import ending_on_signals
from canfb.cli.options import READY_FILE, Commands, add_bus_options, add_command, bus_options, option
from canfb.cli.printing import PRINTING, printed_without_waiting
from canfb.configuration import ANY_NODES, load_config
from canfb.hosting.hosting import Hosting
from canfb.hosting.readiness import Readiness
from canfb.hosting.self_diagnosis import diagnosing_on_signal


def register(commands: Commands) -> None:
    add_command(
        commands,
        "run",
        run,
        option("config", metavar="CONFIG.yaml"),
        option("-v", "--verbose", action="store_true", help="log single faults and each EMCY as well"),
        option("--json", action="store_true", help="print one JSON object a line"),
        READY_FILE,
        add_bus_options,
    )


def run(options: argparse.Namespace) -> int:
    """Serve the nodes until Ctrl-C, SIGTERM or SIGHUP; SIGUSR1 writes a diagnosis."""
    config = load_config(options.config, ANY_NODES)
    serving = Hosting(config, bus_options(options, config.bus), verbose=options.verbose)
    PRINTING.as_json = options.json
    with (
        diagnosing_on_signal(serving.diagnosis.request),  # first: without it the signal kills the process
        printed_without_waiting(),
        Readiness(options.ready_file) as readiness,
        serving,
        ending_on_signals(serving.stop),
    ):
        serving.run(readiness.ready, readiness.alive)
    return 0
