"""``canfb backup save NODE FILE`` and ``canfb backup restore FILE``."""

from __future__ import annotations

import argparse
from importlib.metadata import version
from pathlib import Path

from canfb import objects as od
from canfb.bus.clocks import date_and_time
from canfb.cli import node_options
from canfb.cli.options import (
    JSON,
    TIMEOUT,
    Commands,
    add_bus_options,
    add_command,
    add_group,
    node_or_file,
    nodes,
    option,
    required_file,
)
from canfb.eds_files import eds_path
from canfb.files import check_writable, write_whole
from canfb.master.access import NodeAccess, without_restart
from canfb.module.device_configuration import (
    OF_THE_MACHINE,
    backup_values,
    read_configuration,
    restored_configuration,
)
from canfb.module.parameters import EDS
from canfb.sdo.backups import (
    AFTER_PREOP,
    Backup,
    NodeIdentity,
    backup_result,
    backup_text,
    read_backup,
    restore_backup,
    restored_result,
)
from canfb.sdo.object_description import ObjectDescriptions


def register(commands: Commands) -> None:
    parts = add_group(commands, "backup")
    add_command(
        parts,
        "save",
        save,
        node_options.NODE,
        option("file", metavar="FILE", type=Path, help="to write; replaced"),
        *node_options.ACCESS,
        summary="write table and all parameters of a module to a file (YAML)",
    )
    add_command(
        parts,
        "restore",
        restore,
        nodes(
            "backup, and NODE, the module (default: that of the file)",
            least=1,
            most=1,
            kind=node_or_file,
            file="file",
            name="FILE",
        ),
        option("--save", action="store_true", help="save all parameters at the end (1010h)"),
        option("--preop", action="store_true", help="send the node to PRE-OPERATIONAL first; it stays there"),
        option("--dry-run", action="store_true", help="only show what would change"),
        option(
            "--force",
            action="store_true",
            help="even of another major revision, without parameters that this version lacks",
        ),
        JSON,
        TIMEOUT,
        add_bus_options,
        summary="write a backup to a module, and verify it or roll back",
    )


def save(options: argparse.Namespace) -> int:
    check_writable(options.file)
    described = ObjectDescriptions(eds_path(EDS), options.node)
    with node_options.master_of(options) as master:
        module = NodeAccess(master, options.node, "module")
        with without_restart(module):
            found = backup_of(module, described, date_and_time())
    write_whole(options.file, backup_text(found, described).encode())
    return node_options.say_result(options, backup_result(found, options.file))


def backup_of(module: NodeAccess, described: ObjectDescriptions, date: str) -> Backup:
    configuration = read_configuration(module)
    entries = [entry for place in OF_THE_MACHINE if (entry := described.find(*place)) is not None]
    machine = {entry.place: entry.decode(module.upload_domain(*entry.place)) for entry in entries}
    return Backup(
        module.node_id,
        NodeIdentity(*(module.integer(*place, "I") for place in od.IDENTITY)),
        date,
        version("canfb"),
        module.upload_domain(0x1008, 0).decode("latin-1"),
        backup_values(configuration),
        configuration.table,
        machine,
    )


def restore(options: argparse.Namespace) -> int:
    path = required_file(options.file)
    kept = read_backup(path, ObjectDescriptions(eds_path(EDS), 1), options.force)
    node = options.module or kept.node_id
    with node_options.guarded_master(options, AFTER_PREOP * options.preop) as (master, guard):
        module = NodeAccess(master, node, "module")
        done = restore_backup(
            module,
            kept,
            lambda: read_configuration(module),
            lambda before: restored_configuration(kept.values, before, kept.table, kept.node_id, node),
            guard,
            keep=options.save,
            force=options.force,
            preop=options.preop,
            dry_run=options.dry_run,
        )
    return node_options.say_result(
        options,
        restored_result(
            path,
            kept,
            done,
            ObjectDescriptions(eds_path(EDS), node),
            preop=options.preop,
            dry_run=options.dry_run,
        ),
    )
