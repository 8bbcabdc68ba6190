"""``canfb table show|read|write|activate|clear``: the correction table of a module."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path

from canfb.bus.clocks import date_and_time
from canfb.cli import node_options
from canfb.cli.options import Commands, add_command, add_group, node_number, option
from canfb.errors import ConfigError
from canfb.files import check_writable
from canfb.master.access import NodeAccess
from canfb.rows import Result
from canfb.sdo.tables import TableState, TableTasks, read_table

FILES = "FILE.yaml, or the bytes of 2020:01 under any other name"


def register(commands: Commands) -> None:
    parts = add_group(
        commands, "table", "The correction table (2020h) and the conditioning (2002h) of a module."
    )
    node, access = node_options.NODE, node_options.ACCESS
    force = option("--force", action="store_true", help="even if the amplitude then leaves its limits")
    save = option("--save", action="store_true", help="save it (1010h)")
    add_command(
        parts,
        "show",
        show,
        option("what", metavar="NODE|FILE", help="node-ID such as 32 or 0x20, or a table file"),
        *access,
        summary="show the table of a module or of a file",
    )
    add_command(
        parts,
        "write",
        write,
        node,
        option("file", metavar="FILE", type=Path, help=f"as canfb calibrate writes it: {FILES}"),
        option("--activate", action="store_true", help="put it in force at once"),
        force,
        option("--save", action="store_true", help="with --activate: save it (1010h)"),
        *access,
        summary="stage the table of a file in the module",
        idle=[(["save"], "activate", True, "only with --activate, as a staged table is not saved")],
    )
    add_command(
        parts,
        "read",
        read,
        node,
        option("file", metavar="FILE", type=Path, help=f"{FILES}; replaced"),
        *access,
        summary="read the active table of the module into a file",
    )
    add_command(
        parts, "activate", activate, node, force, save, *access, summary="put the staged table in force"
    )
    add_command(
        parts,
        "clear",
        clear,
        node,
        option("--conditioning", action="store_true", help="clear the conditioning (2002h) as well"),
        save,
        *access,
        summary="go back to the identity: no table",
    )


def show(options: argparse.Namespace) -> int:
    try:
        node = node_number(options.what)
    except argparse.ArgumentTypeError:
        if not os.path.exists(options.what):  # also False for a name that is too long
            raise ConfigError(f"{options.what}: neither a node-ID (1 to 127) nor a file") from None
        file = read_table(Path(options.what))
        state = TableState(options.what, file.used, file.cycles_per_revolution)
    else:
        with node_options.master_of(options) as master:
            state = TableState.of_module(NodeAccess(master, node, "module"))
    return node_options.say_result(options, state.result())


def write(options: argparse.Namespace) -> int:
    file = read_table(options.file)
    return _do(
        options,
        lambda tasks: tasks.upload(file, active=options.activate, keep=options.save, force=options.force),
    )


def read(options: argparse.Namespace) -> int:
    check_writable(options.file)
    return _do(options, lambda tasks: tasks.download(options.file, date_and_time()))


def activate(options: argparse.Namespace) -> int:
    return _do(options, lambda tasks: tasks.activate(keep=options.save, force=options.force))


def clear(options: argparse.Namespace) -> int:
    return _do(options, lambda tasks: tasks.clear(conditioning=options.conditioning, keep=options.save))


def _do(options: argparse.Namespace, task: Callable[[TableTasks], Result]) -> int:
    with node_options.guarded_master(options) as (master, guard):
        result = task(TableTasks(NodeAccess(master, options.node, "module"), guard))
    return node_options.say_result(options, result)
