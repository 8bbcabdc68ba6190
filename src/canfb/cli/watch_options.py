"""Options of the commands that watch modules: which, from where, and in which unit."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from canfb.cli.options import node_or_yaml, positive
from canfb.monitoring.lines import MachineUnits


def add_watched(parser: argparse.ArgumentParser, nodes: str = "node-IDs", *, speed: bool = True) -> None:
    """Nodes, called ``nodes`` in the help, a configuration, or a log, and its speed."""
    parser.add_argument(
        "nodes",
        metavar="NODE",
        nargs="*",
        default=[],
        type=node_or_yaml,
        help=f"{nodes} such as 32 or 0x20; or CONFIG.yaml, as with --config",
    )
    parser.add_argument("--config", metavar="CONFIG.yaml", help="takes modules and bus from it")
    parser.add_argument("--log", metavar="FILE", type=Path, help="a log that python-can reads, not a bus")
    if speed:
        parser.add_argument("--speed", metavar="X", type=positive, help="of the log: 1 in its own time")


def add_machine_unit(parser: argparse.ArgumentParser) -> None:
    """``--per-revolution``."""
    parser.add_argument(
        "--per-revolution", metavar="'5 mm'", type=units, default=MachineUnits(), help="unit of the machine"
    )


def bit_rate_of(words: Mapping[str, Any]) -> int | None:
    """The bit rate among python-can's words, bit/s; None without one."""
    bit_rate = words.get("bitrate")
    return bit_rate if isinstance(bit_rate, int) and bit_rate > 0 else None


def units(text: str) -> MachineUnits:
    """A unit of the machine such as "5 mm": a type for argparse."""
    try:
        return MachineUnits.parse(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
