"""``canfb node``: nodes on a bus, and NMT commands (CiA 301, 7.2.8.3.1).

``reset`` refuses while a machine moves: a module that starts in motion may count wrong.
"""

from __future__ import annotations

import argparse

from canfb.bus.bus_master import BusMaster
from canfb.bus.opening import open_bus
from canfb.cia301.codes import NmtCommand
from canfb.cli import node_options
from canfb.cli.options import (
    JSON,
    TIMEOUT,
    Commands,
    add_bus_options,
    add_command,
    add_group,
    chosen_bus,
    node_number,
    nodes,
    option,
    positive,
)
from canfb.cli.printing import shown_progress
from canfb.master.access import CommissioningError, reset_nodes
from canfb.rows import Result

WORDS = {
    "start": (NmtCommand.START, "to OPERATIONAL: PDOs are sent and received"),
    "stop": (NmtCommand.STOP, "to STOPPED: only NMT and error control remain"),
    "preop": (NmtCommand.ENTER_PRE_OPERATIONAL, "to PRE-OPERATIONAL: SDO, no PDO"),
}
ALL, EVERYBODY = "all", 0
NOBODY = (
    "no node answers, and no heartbeat is heard: check the bus, its bit rate and power. "
    "A STOPPED node without heartbeat is silent: canfb node preop all"
)
SCAN_S = 1.2  # most nodes send a heartbeat at least once a second


def _node(text: str) -> int:
    return EVERYBODY if text == ALL else node_number(text)


def register(commands: Commands) -> None:
    parts = add_group(
        commands, "node", "Nodes of a bus. NMT is not confirmed: a node reports its state in its heartbeat."
    )
    add_command(
        parts,
        "list",
        listed,
        option("--seconds", metavar="S", type=positive, default=SCAN_S, help="how long to listen (1.2)"),
        JSON,
        node_options.CONFIG,
        add_bus_options,
        summary="list the nodes with NMT state and identity (1018h)",
    )
    named = nodes("node-IDs such as 32 or 0x20, or all", least=1, kind=_node)
    for word, (command, summary) in WORDS.items():
        add_command(parts, word, send, named, add_bus_options, summary=summary, command_specifier=command)
    add_command(
        parts,
        "reset",
        reset,
        named,
        option(
            "--communication", action="store_true", help="only the communication parameters (1000h to 1FFFh)"
        ),
        option("--force", action="store_true", help="do not check that the machine stands still"),
        JSON,
        TIMEOUT,
        add_bus_options,
        summary="reset nodes as by a power cycle; modules at standstill only",
    )


def _nodes(options: argparse.Namespace) -> list[int]:
    return [EVERYBODY] if EVERYBODY in options.nodes else list(dict.fromkeys(options.nodes))


def send(options: argparse.Namespace) -> int:
    chosen = _nodes(options)
    with BusMaster(open_bus(chosen_bus(options))) as master:
        for node in chosen:
            master.send(0x000, bytes((options.command_specifier, node)))
    names = "all nodes" if chosen == [EVERYBODY] else ", ".join(f"{node} ({node:02X}h)" for node in chosen)
    print(f"{options.part}: {names}")
    return 0


def reset(options: argparse.Namespace) -> int:
    from canfb.diagnosis.nodes_and_frames import scan  # here: an NMT command needs no EDS

    chosen = _nodes(options)
    command = NmtCommand.RESET_COMMUNICATION if options.communication else NmtCommand.RESET_NODE
    with node_options.master_of(options) as master, shown_progress(quiet=options.json) as progress:
        if chosen == [EVERYBODY]:
            chosen = [one.node for one in scan(master, SCAN_S)]
            if not chosen:
                raise CommissioningError(NOBODY)
        done = reset_nodes(master, chosen, command, progress.part, force=options.force)
    lines = [f"node {one['node']} ({one['node']:02X}h): reset" for one in done]
    if len(done) == 1 and done[0]["position"]:
        spread = done[0]["spread_cycles"]
        machine = "not looked at" if spread is None else f"still, within {spread:.3f} cycle"
        lines[0] += f" and started; position {done[0]['position']}, machine {machine}"
    return node_options.say_result(options, Result(done[0] if len(done) == 1 else done, lines))


def listed(options: argparse.Namespace) -> int:
    from canfb.diagnosis.nodes_and_frames import scan  # here: an NMT command needs no EDS

    with BusMaster(open_bus(chosen_bus(options)), 0.3) as master:
        found = scan(master, options.seconds)
    lines = [one.line() for one in found] or [NOBODY]
    return node_options.say_result(options, Result([one.figures() for one in found], lines))
