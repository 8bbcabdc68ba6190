"""``canfb sdo read|write NODE OBJECT``: one object of a node, by its name in the EDS or its number."""

from __future__ import annotations

import argparse
from pathlib import Path

from canfb.cli import node_options
from canfb.cli.options import Commands, add_command, add_group, option
from canfb.eds_files import EDS_NAMES, eds_path
from canfb.errors import ConfigError
from canfb.files import check_writable, read_bytes, write_whole
from canfb.master.access import CommissioningError, Master, NodeAccess
from canfb.rows import Result, Row, as_columns, those
from canfb.sdo.object_description import ObjectDescriptions
from canfb.sdo.sdo_tasks import SdoTasks, described_by, is_lost

OBJECT = """the name in the EDS or its beginning, in any case ("residual limit", "supervision: residual"), \
or index:sub as in manuals, hexadecimal (2010:01)"""

COLUMNS = ("object", "access", "name", "unit")
LOST = "the position is lost: canfb why {:#04x} says why, and what brings it back"


def register(commands: Commands) -> None:
    parts = add_group(
        commands, "sdo", "Objects of a node by SDO. Names, types and units are those of its EDS."
    )
    node, access = node_options.NODE, node_options.ACCESS
    named = option("object", metavar="OBJECT", help=OBJECT)
    eds = option("--eds", type=Path, metavar="FILE", help="EDS or DCF of a node other than those of canfb")
    add_command(
        parts,
        "read",
        read,
        node,
        named,
        option("--out", type=Path, metavar="FILE", help="write the bytes to a file; replaced"),
        eds,
        *access,
        summary="read an object; without :sub, all of a record",
    )
    add_command(
        parts,
        "list",
        listed,
        node,
        option(
            "object",
            metavar="OBJECT",
            nargs="?",
            default="",
            help="only those with this text in number or name",
        ),
        option("--eds", type=Path, metavar="FILE", help="EDS or DCF (default: by the node's identity)"),
        *access,
        summary="the objects of a node by its EDS: number, name, access, unit",
    )
    add_command(
        parts,
        "write",
        write,
        node,
        named,
        option(
            "value",
            metavar="VALUE",
            nargs="?",
            help="12, 0x1F, -3.5, a text, bytes in hexadecimal, or a word (save); in the unit that read "
            'shows: 0.2 or "0.2 cycle"',
        ),
        option("--raw", action="store_true", help="VALUE is the raw number, without a unit"),
        option("--file", type=Path, metavar="FILE", help="write the bytes of a file instead of VALUE"),
        eds,
        *access,
        summary="write an object, and read it back",
    )


def _tasks(master: Master, options: argparse.Namespace) -> SdoTasks:
    node = NodeAccess(master, options.node, "node")
    if options.eds is not None:
        return SdoTasks(node, ObjectDescriptions(options.eds, options.node))
    return SdoTasks(node, described_by(node, map(eds_path, EDS_NAMES), options.object))


def listed(options: argparse.Namespace) -> int:
    if options.eds is not None:
        described = ObjectDescriptions(options.eds, options.node)
    else:
        with node_options.master_of(options) as master:
            described = described_by(NodeAccess(master, options.node, "node"), map(eds_path, EDS_NAMES), "")
    rows = [
        Row(one.number, one.access, one.title, one.unit)
        for one in described
        if options.object.lower() in f"{one.number} {one.title}".lower()
    ]
    figures = [dict(zip(COLUMNS, (row.name, *row.words), strict=True)) for row in rows]
    return node_options.say_result(
        options,
        Result(
            figures,
            as_columns(rows, COLUMNS) if rows else [f"no object has {options.object!r} in number or name"],
        ),
    )


def read(options: argparse.Namespace) -> int:
    if options.out is not None:
        check_writable(options.out)
    with node_options.master_of(options) as master:
        readings = _tasks(master, options).read(options.object)
    lines = [
        *(reading.line() for reading in readings),
        *those((any(map(is_lost, readings)), LOST.format(options.node))),
    ]
    if options.out is not None:
        if len(readings) > 1:
            raise ConfigError(f"--out: {options.object!r} has several entries; give one of them, index:sub")
        write_whole(options.out, readings[0].data)
        lines = [f"{options.out}: {readings[0].entry.title}, {len(readings[0].data)} bytes"]
    return node_options.say_result(options, Result([reading.figures() for reading in readings], lines))


def write(options: argparse.Namespace) -> int:
    if (options.value is None) == (options.file is None):
        raise ConfigError("a VALUE or --file FILE is required, one of them")
    value = options.value if options.file is None else read_bytes(options.file, CommissioningError)
    with node_options.master_of(options) as master:
        result = _tasks(master, options).write(options.object, value, raw=options.raw)
    return node_options.say_result(options, result)
