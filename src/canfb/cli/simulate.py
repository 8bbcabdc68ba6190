"""``canfb simulate CONFIG.yaml``: the encoder interface on a bus, with a motion, a recording or a drive."""

from __future__ import annotations

import argparse

from canfb.bus.opening import check_device_bus
from canfb.bus.runner import ending_on_signals
from canfb.cli.log_printing import printed_without_waiting
from canfb.cli.options import Commands, add_command, bus_options
from canfb.cli.printing import say
from canfb.cli.simulate_options import add_options, chosen
from canfb.cli.simulate_record import check_record, write_record
from canfb.configuration import load_config
from canfb.hosting.readiness import Readiness
from canfb.hosting.simulating import Simulating


def register(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "simulate",
        "simulate the encoder interface, with a motion, a recording or a drive, on a bus",
        simulate,
    )
    add_options(parser)


def simulate(options: argparse.Namespace) -> int:
    """Serve the encoder interface until Ctrl-C, SIGTERM, SIGHUP, --seconds or the end of the recording."""
    config = load_config(options.config)
    words = bus_options(options, config.bus)
    check_device_bus(words)
    what = chosen(options, config)
    record = None if options.record is None else check_record(options.record)
    simulating = Simulating(*what, words, config.realtime, options.seconds)
    network = simulating.network
    with (
        printed_without_waiting(),
        Readiness(options.ready_file) as readiness,
        simulating,
        ending_on_signals(simulating.stop),
    ):
        try:
            simulating.run(readiness.ready)
        finally:
            if record is not None:
                write_record(record, network.recorder, network.rate_hz)
    interface = network.interface
    say(f"{interface.samples} samples sent{'; end of the recording' if interface.ended else ''}")
    if record is not None:
        say(f"written  {record}")
    if network.axis is not None:
        say(network.axis.summary())
    return 0
