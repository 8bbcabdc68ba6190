"""``canfb reset NODE``: restart a module whose machine stands still."""

from __future__ import annotations

import argparse

from canfb.cli import node_options
from canfb.cli.options import Commands, add_command
from canfb.master.access import NodeAccess
from canfb.master.node_state import reset_module
from canfb.rows import Result


def register(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(commands, "reset", "reset and start a module, at standstill only", reset)
    node_options.add_node(parser)
    parser.add_argument("--force", action="store_true", help="do not look whether the machine moves")
    node_options.add_access_options(parser)


def reset(options: argparse.Namespace) -> int:
    """Look at the machine, reset the module, start it, and say what became of its position."""
    with node_options.master_of(options) as master:
        module = NodeAccess(master, options.node, "module")
        done = reset_module(module, force=options.force)
    seen = "not looked at" if options.force else f"still, within {done['spread_cycles']:.3f} cycle"
    line = f"{module.name}: reset and started; position {done['position']}, machine {seen}"
    return node_options.say_result(options, Result(done, [line]))
