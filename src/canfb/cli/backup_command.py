"""``canfb backup NODE FILE`` and ``canfb restore FILE``: table and parameters of a module as a file."""

from __future__ import annotations

import argparse
from importlib.metadata import version
from pathlib import Path
from typing import Any

from canfb import objects as od
from canfb.bus.clocks import date_and_time
from canfb.cli import node_options
from canfb.cli.options import Commands, add_command, node_number
from canfb.eds_files import eds_path
from canfb.master.access import Master, NodeAccess
from canfb.master.all_or_nothing import check_writable, write_whole
from canfb.module.device_configuration import (
    OF_THE_MACHINE,
    backup_values,
    read_configuration,
    restored_configuration,
)
from canfb.module.parameters import EDS
from canfb.sdo.backup_file import Backup, NodeIdentity, backup_text, read_backup
from canfb.sdo.backup_tasks import RestoreOptions, Restoring, backup_result, restored_result
from canfb.sdo.object_description import ObjectDescriptions


def register(commands: Commands) -> None:
    """Add both commands."""
    parser = add_command(commands, "backup", backup)
    node_options.add_node(parser)
    parser.add_argument("file", metavar="FILE", type=Path, help="replaced")
    node_options.add_access_options(parser)

    parser = add_command(commands, "restore", restore)
    parser.add_argument("file", metavar="FILE", type=Path, help="what canfb backup wrote")
    parser.add_argument(
        "--node", type=node_number, metavar="ID", help="the module (default: the node-ID in the file)"
    )
    parser.add_argument("--save", action="store_true", help="save all parameters at the end (1010h)")
    parser.add_argument(
        "--preop", action="store_true", help="send the node to PRE-OPERATIONAL first; it stays there"
    )
    parser.add_argument("--dry-run", action="store_true", help="only say what would change")
    parser.add_argument(
        "--force",
        action="store_true",
        help="also a backup of another major revision, less the parameters that this version does not know",
    )
    node_options.add_access_options(parser)


def backup(options: argparse.Namespace) -> int:
    """From the module to the file."""
    check_writable(options.file)
    described = ObjectDescriptions(eds_path(EDS), options.node)
    with node_options.master_of(options) as master:
        found = backup_of(master, options.node, date_and_time())
    write_whole(options.file, backup_text(found, described).encode())
    return node_options.say_result(options, backup_result(found, options.file))


def backup_of(master: Master, node_id: int, date: str) -> Backup:
    """Parameters and table of a module. Raises CanfbError if it cannot be read or is not a module."""
    module = NodeAccess(master, node_id, "module")
    configuration = read_configuration(module)
    template = ObjectDescriptions(eds_path(EDS), node_id)
    machine: dict[tuple[int, int], Any] = {}
    for place in OF_THE_MACHINE:
        entry = template.find(*place)
        if entry is not None:
            machine[entry.place] = entry.decode(module.upload_domain(*place))
    return Backup(
        node_id,
        NodeIdentity(*(module.integer(*place, "I") for place in od.IDENTITY)),
        date,
        version("canfb"),
        module.upload_domain(0x1008, 0).decode("latin-1"),
        backup_values(configuration),
        configuration.table,
        machine,
    )


def restore(options: argparse.Namespace) -> int:
    """From the file to the module."""
    kept = read_backup(options.file, ObjectDescriptions(eds_path(EDS), 1), options.force)
    node = options.node or kept.node_id
    wishes = RestoreOptions(options.save, options.force, options.preop, options.dry_run)
    with node_options.guarded() as guard, node_options.master_of(options) as master:
        module = NodeAccess(master, node, "module")
        restoring = Restoring(module, lambda: read_configuration(module), guard)
        done = restoring.restore(
            kept,
            lambda before: restored_configuration(kept.values, before, kept.table, kept.node_id, node),
            wishes,
        )
    described = ObjectDescriptions(eds_path(EDS), node)
    return node_options.say_result(options, restored_result(options.file, kept, done, described))
