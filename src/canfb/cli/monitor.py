"""``canfb monitor [NODE...]``: feedback modules live in the terminal, from a bus or from a log."""

from __future__ import annotations

import argparse

from canfb.bus.runner import ending_on_signals
from canfb.cli.monitor_output import output
from canfb.cli.options import Commands, add_bus_options, add_command, bus_options, refuse_idle
from canfb.cli.watch_options import add_machine_unit, add_watched, bit_rate_of, positive
from canfb.cli.yaml_argument import take_yaml
from canfb.configuration import Config, load_config
from canfb.errors import ConfigError
from canfb.monitoring.bus_model import BusModel
from canfb.monitoring.known_modules import assumed_layout, known_layouts
from canfb.monitoring.sdo_reading import SdoReading
from canfb.monitoring.watching import Watching

FASTEST_HZ = 50.0


def register(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(commands, "monitor", "watch modules live, on a bus or in a log", monitor)
    add_watched(parser)
    parser.add_argument("--rate", metavar="HZ", type=positive, help="updates per second (5; 1 for lines)")
    parser.add_argument("--seconds", metavar="S", type=positive, help="end after so long")
    parser.add_argument(
        "--sdo", action="store_true", help="read mapping and counters by SDO; without it, only listen"
    )
    add_machine_unit(parser)
    parser.add_argument("--plain", action="store_true", help="lines, also on a terminal")
    parser.add_argument("--json", action="store_true", help="print one JSON object per update")
    add_bus_options(parser)


def monitor(options: argparse.Namespace) -> int:
    """Show what there is to see until Ctrl-C, the end of the log, or --seconds."""
    take_yaml(options)
    config = load_config(options.config) if options.config else Config()
    words = bus_options(options, config.bus)
    if options.log is None:
        refuse_idle(options, ["speed"], "goes with --log")
    else:
        refuse_idle(options, ["sdo"], "a log answers no SDO")
    layouts = known_layouts(config, options.nodes)
    if options.sdo and not layouts:
        raise ConfigError("--sdo: name the nodes that may be asked, or give --config")
    model = BusModel(layouts, assumed_layout, bit_rate_of(words), only_known=bool(options.nodes))
    readings = [SdoReading(layout.node_id) for layout in layouts] if options.sdo else []
    with output(options, "canfb monitor") as (show, rate_hz):
        watching = Watching(model, show, min(options.rate or rate_hz, FASTEST_HZ), readings)
        with ending_on_signals(watching.stop):
            if options.log is not None:
                own_time = None if options.json or options.plain else 1.0
                watching.log(options.log, options.speed or own_time, options.seconds)
            else:
                watching.bus(words, options.seconds)
    return 0
