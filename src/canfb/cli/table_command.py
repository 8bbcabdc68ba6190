"""``canfb table show|read|write|activate|clear``: the correction table of a module."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from canfb.bus.clocks import date_and_time
from canfb.cli import node_options
from canfb.cli.options import Commands, add_command, add_group, add_options, option
from canfb.cli.subjects import node_number
from canfb.errors import ConfigError
from canfb.master.access import NodeAccess
from canfb.master.all_or_nothing import check_writable
from canfb.rows import Result
from canfb.sdo.table_file import TableState, read_table_file
from canfb.sdo.table_tasks import TableTasks

FORCE = "although the amplitude then leaves its limits"
FILES = "FILE.yaml, or the bytes of 2020:01 under any other name"


def register(commands: Commands) -> None:
    """Add the commands."""
    description = "The correction table (2020h) and the conditioning (2002h) of a module."
    parts = add_group(commands, "table", description)
    part = add_command(parts, "show", show, "show the table of a module or of a file")
    part.add_argument("what", metavar="NODE|FILE", help="node-ID such as 32 or 0x20, or a table file")
    node_options.add_access_options(part)

    part = _add(parts, "write", "write the table of a file to the module, and stage it", write)
    add_options(
        part,
        option("file", metavar="FILE", type=Path, help=f"as canfb calibrate writes it: {FILES}"),
        option("--activate", action="store_true", help="put it in force at once"),
        option("--force", action="store_true", help=FORCE),
    )
    _finish(part, "with --activate: save it (1010h)")

    part = _add(parts, "read", "read the active table of the module into a file", read)
    part.add_argument("file", metavar="FILE", type=Path, help=f"{FILES}; replaced")
    node_options.add_access_options(part)

    part = _add(parts, "activate", "put the staged table in force", activate)
    part.add_argument("--force", action="store_true", help=FORCE)
    _finish(part, "save it (1010h)")

    part = _add(parts, "clear", "go back to the identity: no table", clear)
    part.add_argument("--conditioning", action="store_true", help="clear the conditioning (2002h) as well")
    _finish(part, "save it (1010h)")


def _add(parts: Commands, name: str, summary: str, action: object) -> argparse.ArgumentParser:
    part = add_command(parts, name, action, summary)  # type: ignore[arg-type]
    node_options.add_node(part)
    return part


def _finish(part: argparse.ArgumentParser, saves: str) -> None:
    part.add_argument("--save", action="store_true", help=saves)
    node_options.add_access_options(part)


def show(options: argparse.Namespace) -> int:
    """The table of a node, or of a file."""
    try:
        node = node_number(options.what)
    except argparse.ArgumentTypeError:
        if not Path(options.what).exists():
            raise ConfigError(f"{options.what}: neither a node-ID (1 to 127) nor a file") from None
        state = TableState.of_file(read_table_file(options.what))
    else:
        with node_options.master_of(options) as master:
            state = TableState.of_module(NodeAccess(master, node, "module"))
    return node_options.say_result(options, state.result())


def write(options: argparse.Namespace) -> int:
    """From the file to the module."""
    if options.save and not options.activate:
        raise ConfigError("--save: only with --activate, as a staged table is not saved")
    file = read_table_file(options.file)
    return _do(
        options,
        lambda tasks: tasks.upload(file, active=options.activate, keep=options.save, force=options.force),
    )


def read(options: argparse.Namespace) -> int:
    """From the module to the file."""
    check_writable(options.file)
    return _do(options, lambda tasks: tasks.download(options.file, date_and_time()))


def activate(options: argparse.Namespace) -> int:
    """The staged table is put in force."""
    return _do(options, lambda tasks: tasks.activate(keep=options.save, force=options.force))


def clear(options: argparse.Namespace) -> int:
    """No table."""
    return _do(options, lambda tasks: tasks.clear(conditioning=options.conditioning, keep=options.save))


def _do(options: argparse.Namespace, task: Callable[[TableTasks], Result]) -> int:
    with node_options.guarded() as guard, node_options.master_of(options) as master:
        result = task(TableTasks(NodeAccess(master, options.node, "module"), guard))
    return node_options.say_result(options, result)
