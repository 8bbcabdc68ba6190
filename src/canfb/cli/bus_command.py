"""``canfb bus scan``: who is on a bus."""

from __future__ import annotations

import argparse

from canfb.bus.bus_master import BusMaster
from canfb.bus.opening import open_bus
from canfb.cli.node_options import say_result
from canfb.cli.options import Commands, add_bus_options, add_command, bus_options
from canfb.cli.watch_options import positive
from canfb.cli.yaml_argument import yaml_file
from canfb.configuration import ANY_NODES, load_config
from canfb.diagnosis.nodes_on_bus import scan
from canfb.rows import Result

LISTEN_S = 1.2  # the heartbeat of most nodes comes once a second or more often


def register(commands: Commands) -> None:
    """Add the commands."""
    parser = commands.add_parser(
        "bus", help="who is on a bus", description="What is on a bus, whatever nodes it has."
    )
    parts = parser.add_subparsers(dest="part", required=True, metavar="scan")
    part = add_command(parts, "scan", "list the nodes with NMT state and identity (1018h)", bus_scan)
    part.add_argument("--seconds", metavar="S", type=positive, default=LISTEN_S, help="to listen (1.2)")
    part.add_argument("--json", action="store_true", help="the result, for programs")
    part.add_argument("--config", metavar="CONFIG.yaml", help="takes the bus from this configuration")
    part.add_argument(
        "configuration", metavar="CONFIG.yaml", nargs="?", type=yaml_file, help="the same, without --config"
    )
    add_bus_options(part)


def bus_scan(options: argparse.Namespace) -> int:
    """Ask all node-IDs, and say who is there."""
    chosen = options.config or options.configuration
    words = bus_options(options, load_config(chosen, ANY_NODES).bus if chosen else {})
    with BusMaster(open_bus(words), 0.3) as master:
        found = scan(master, options.seconds)
    nobody = "no node answers, and no heartbeat is heard: are the bus, its bit rate and its power right?"
    lines = [one.line() for one in found] or [nobody]
    return say_result(options, Result([one.figures() for one in found], lines))
