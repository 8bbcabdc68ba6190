"""Options that several commands share."""

from __future__ import annotations

import argparse
import errno
import os
import sys
from collections.abc import Callable
from typing import Any, TextIO

import can.cli

Commands = Any  # argparse's sub-parser action has no public name


def add_command(
    commands: Commands, name: str, summary: str, action: Callable[[argparse.Namespace], int]
) -> argparse.ArgumentParser:
    """Add a command that calls ``action``; its parser, for its own options."""
    parser: argparse.ArgumentParser = commands.add_parser(name, help=summary, description=summary)
    parser.add_argument(
        "--debug", action="store_true", default=argparse.SUPPRESS, help="show the traceback of an error"
    )
    parser.set_defaults(action=action)
    return parser


def add_bus_options(parser: argparse.ArgumentParser) -> None:
    """The bus options of python-can: -i, -c, -b and so on."""
    can.cli.add_bus_arguments(parser)


BUS_WORDS = ("interface", "channel", "bitrate", "fd", "data_bitrate", "timing")


def bus_options(options: argparse.Namespace, configured: dict[str, Any]) -> dict[str, Any]:
    """python-can's words: the configuration's, replaced by those of the command line."""
    merged = dict(configured)
    for word in BUS_WORDS:
        if hasattr(options, word):
            merged[word] = getattr(options, word)
    merged.update(getattr(options, "bus_kwargs", {}))
    return merged


def report(text: str) -> None:
    """One line on stderr."""
    _print(f"canfb: {text}", sys.stderr)


def say(text: str) -> None:
    """One line on stdout, of a program that goes on after it."""
    _print(text, sys.stdout)


def _print(text: str, stream: TextIO) -> None:
    """Print at once. A reader or a terminal that has gone is no reason to end: say nothing more there."""
    try:
        print(text, file=stream, flush=True)
    except OSError as error:
        if error.errno not in (errno.EPIPE, errno.EIO):
            raise
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def add_ready_file(parser: argparse.ArgumentParser) -> None:
    """``--ready-file``, for :class:`canfb.bus.readiness.Readiness`."""
    parser.add_argument(
        "--ready-file", metavar="PATH", help="a file that is there while the program is on the bus"
    )
