"""``canfb reset``, ``canfb bus scan`` and ``canfb nmt``: which nodes are on a bus, and their NMT states.

``nmt`` sends one NMT command (CiA 301, 7.2.8.3.1), whatever the machine does; ``reset`` restarts a module
whose machine stands still; ``bus scan`` asks all node-IDs.
"""

from __future__ import annotations

import argparse

from canfb.bus.bus_master import BusMaster
from canfb.bus.opening import open_bus
from canfb.cia301.nmt import NmtCommand
from canfb.cli import node_options
from canfb.cli.options import (
    Commands,
    add_bus_options,
    add_command,
    chosen_bus,
    node_or_yaml,
    positive,
    take_yaml,
)
from canfb.errors import ConfigError
from canfb.master.access import NodeAccess
from canfb.master.node_state import reset_module
from canfb.rows import Result

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
SCAN_S = 1.2  # the heartbeat of most nodes comes once a second or more often


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
    parser = add_command(commands, "reset", reset)
    node_options.add_node(parser)
    parser.add_argument("--force", action="store_true", help="do not look whether the machine moves")
    node_options.add_access_options(parser)

    parser = commands.add_parser(
        "bus", help="who is on a bus", description="What is on a bus, whatever nodes it has."
    )
    parts = parser.add_subparsers(dest="part", required=True, metavar="scan")
    part = add_command(parts, "scan", bus_scan, "list the nodes with NMT state and identity (1018h)")
    part.add_argument("--seconds", metavar="S", type=positive, default=SCAN_S, help="to listen (1.2)")
    node_options.add_access_options(part, answers=False)

    parser = commands.add_parser(
        "nmt",
        help="start, stop or reset nodes",
        description="Send one NMT command. It is not confirmed: a node reports its state in its heartbeat.",
        epilog="example: canfb nmt start all -i socketcan -c can0",
    )
    parts = parser.add_subparsers(dest="part", required=True, metavar="|".join(WORDS))
    for word, (command, summary) in WORDS.items():
        part = add_command(parts, word, nmt, summary)
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
    nodes = [EVERYBODY] if EVERYBODY in options.nodes else list(dict.fromkeys(options.nodes))
    with BusMaster(open_bus(chosen_bus(options))) as master:
        for node in nodes:
            master.send(0x000, bytes((options.command_specifier, node)))
    names = "all nodes" if nodes == [EVERYBODY] else ", ".join(f"{node} ({node:02X}h)" for node in nodes)
    print(f"{options.part}: {names}")
    return 0


def reset(options: argparse.Namespace) -> int:
    """Look at the machine, reset the module, start it, and say what became of its position."""
    with node_options.master_of(options) as master:
        module = NodeAccess(master, options.node, "module")
        done = reset_module(module, force=options.force)
    machine = "not looked at" if options.force else f"still, within {done['spread_cycles']:.3f} cycle"
    line = f"{module.name}: reset and started; position {done['position']}, machine {machine}"
    return node_options.say_result(options, Result(done, [line]))


def bus_scan(options: argparse.Namespace) -> int:
    """Ask all node-IDs, and say who is there."""
    from canfb.diagnosis.nodes_on_bus import scan  # here: an NMT command needs no EDS

    with BusMaster(open_bus(chosen_bus(options)), 0.3) as master:
        found = scan(master, options.seconds)
    nobody = "no node answers, and no heartbeat is heard: are the bus, its bit rate and its power right?"
    lines = [one.line() for one in found] or [nobody]
    return node_options.say_result(options, Result([one.figures() for one in found], lines))
