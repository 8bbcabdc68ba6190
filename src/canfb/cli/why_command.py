"""``canfb why NODE``: why the position of a module is not valid, and what to do."""

from __future__ import annotations

import argparse

from canfb.cli import node_options
from canfb.cli.options import Commands, add_command
from canfb.diagnosis.lost import read_lost_position
from canfb.master.access import NodeAccess


def register(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands, "why", "why the position of a module is not valid, and what brings it back", why
    )
    node_options.add_node(parser)
    node_options.add_access_options(parser)


def why(options: argparse.Namespace) -> int:
    """Read what the module keeps of its last loss, and say what to do."""
    with node_options.master_of(options) as master:
        found = read_lost_position(NodeAccess(master, options.node, "module"))
    return node_options.say_result(options, found.result())
