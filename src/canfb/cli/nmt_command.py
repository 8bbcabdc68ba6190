"""``canfb nmt COMMAND NODE...|all``: one NMT command (CiA 301, 7.2.8.3.1) to nodes of a bus."""

from __future__ import annotations

import argparse

from canfb.bus.bus_master import BusMaster
from canfb.bus.opening import open_bus
from canfb.cia301.nmt import NmtCommand
from canfb.cli.options import Commands, add_bus_options, add_command, bus_options
from canfb.cli.yaml_argument import node_or_yaml, take_yaml
from canfb.configuration import ANY_NODES, load_config
from canfb.errors import ConfigError

WORDS = {
    "start": (NmtCommand.START, "to OPERATIONAL: PDOs are sent and received"),
    "stop": (NmtCommand.STOP, "to STOPPED: only NMT and error control remain"),
    "preop": (NmtCommand.ENTER_PRE_OPERATIONAL, "to PRE-OPERATIONAL: SDO, no PDO"),
    "reset": (
        NmtCommand.RESET_NODE,
        "reset of the node, as by a power cycle, whatever its machine does",
    ),
    "reset-comm": (NmtCommand.RESET_COMMUNICATION, "reset of the communication parameters (1000h to 1FFFh)"),
}
ALL, EVERYBODY = "all", 0


def _node(text: str) -> int | str:
    """A node-ID, decimal or as 0x20; `all` is 0; or a configuration."""
    if text == ALL:
        return EVERYBODY
    try:
        return node_or_yaml(text)
    except argparse.ArgumentTypeError as error:
        raise argparse.ArgumentTypeError(f"{error}, nor 'all'") from None


def register(commands: Commands) -> None:
    """Add the commands."""
    parser = commands.add_parser(
        "nmt",
        help="start, stop or reset nodes",
        description="Send one NMT command. It is not confirmed: a node reports its state in its heartbeat.",
        epilog="example: canfb nmt start all -i socketcan -c can0",
    )
    parts = parser.add_subparsers(dest="part", required=True, metavar="|".join(WORDS))
    for word, (command, summary) in WORDS.items():
        part = add_command(parts, word, summary, nmt)
        part.set_defaults(command_specifier=command)
        part.add_argument(
            "nodes",
            metavar="NODE",
            nargs="+",
            type=_node,
            help="node-IDs such as 32 or 0x20, or all; and CONFIG.yaml, as with --config",
        )
        part.add_argument("--config", metavar="CONFIG.yaml", help="take the bus from this configuration")
        add_bus_options(part)


def nmt(options: argparse.Namespace) -> int:
    """Send the command to each node, in this order, and say so."""
    take_yaml(options)
    if not options.nodes:
        raise ConfigError("a node-ID, several, or all is required beside CONFIG.yaml")
    configured = load_config(options.config, ANY_NODES).bus if options.config else {}
    nodes = [EVERYBODY] if EVERYBODY in options.nodes else list(dict.fromkeys(options.nodes))
    with BusMaster(open_bus(bus_options(options, configured))) as master:
        for node in nodes:
            master.send(0x000, bytes((options.command_specifier, node)))
    names = "all nodes" if nodes == [EVERYBODY] else ", ".join(f"{node} ({node:02X}h)" for node in nodes)
    print(f"{options.part}: {names}")
    return 0
