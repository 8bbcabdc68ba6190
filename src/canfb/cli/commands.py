"""The parser of the command line, and the file of each command, which is imported when the command is used.

So ``canfb --help`` imports none of them, and a command imports what it uses itself. To add a command:
write its file with ``register()``, and its line here.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NamedTuple, NoReturn

from canfb.cli.examples import examples_of


class CommandEntry(NamedTuple):
    """A command: its name, its file in this folder, and the summary for ``canfb --help``."""

    name: str
    file: str
    summary: str


COMMANDS = tuple(
    CommandEntry(*entry)
    for entry in (
        ("demo", "demo", "start, track, calibrate, upload, verify and survive faults on an in-process bus"),
        ("try", "try_command", "a module, its encoder and its page on a private bus, in one command"),
        (
            "plan",
            "plan_command",
            "what bit rate, SYNC rate, speed and acceleration allow, before there is a machine",
        ),
        ("run", "run", "run the feedback modules of a configuration on a bus"),
        ("interface", "run", "run the encoder interface of a configuration, with an ADC, on a bus"),
        ("monitor", "monitor", "watch modules live, on a bus or in a log"),
        ("dump", "dump_command", "show frames, PDOs of modules and interfaces decoded"),
        ("scope", "scope", "watch modules on a local web page"),
        (
            "simulate",
            "simulate",
            "simulate the encoder interface, with a motion, a recording or a drive, on a bus",
        ),
        ("why", "diagnose_command", "why the position of a module is not valid, and what brings it back"),
        (
            "diagnose",
            "diagnose_command",
            "write one file for whoever is to help: versions, settings, objects, log",
        ),
        ("reset", "nmt_command", "reset and start a module, at standstill only"),
        ("bus", "nmt_command", "who is on a bus"),
        ("nmt", "nmt_command", "start, stop or reset nodes"),
        ("sdo", "sdo_command", "read or write one object of a node, by name or number"),
        (
            "calibrate",
            "calibrate",
            "measure the encoder, build its correction table, activate it and save it",
        ),
        (
            "commission",
            "commission",
            "propose the limits of the supervision from the machine's own motion, and set them",
        ),
        (
            "table",
            "table_command",
            "show, upload, download, activate or clear the correction table of a module",
        ),
        ("backup", "backup_command", "write table and all parameters of a module to a file (YAML)"),
        ("restore", "backup_command", "write a backup to a module, prove it, or put back what was before"),
        ("record", "record", "write a log of the bus"),
        ("replay", "replay", "put a recorded bus log through the same module"),
        ("config", "config_file", "check a configuration, print an example, write a DCF"),
    )
)
SUMMARIES = {entry.name: entry.summary for entry in COMMANDS}


def named_command(words: Sequence[str]) -> str:
    """The command of a command line without its program: the first word that is no option, or ""."""
    return next((word for word in words if not word.startswith("-")), "")


def add_commands(commands: Any, name: str | None = None) -> None:
    """Add the commands to argparse's sub-parsers: all of them, or only ``name`` with its own options.

    The others are then there by name and summary, for the help and the message of a wrong command.
    """
    files = {entry.file for entry in COMMANDS if name in (None, entry.name)}
    added: set[str] = set()
    for entry in COMMANDS:
        if entry.file not in files:
            commands.add_parser(entry.name, help=entry.summary)
        elif entry.file not in added:  # a file may have several commands
            added.add(entry.file)
            import_module(f"canfb.cli.{entry.file}").register(commands)


WRONG_USE = 2


class _Parser(argparse.ArgumentParser):
    """Says in one line what is wrong, without the list of all options."""

    def error(self, message: str) -> NoReturn:
        """End with exit code 2."""
        self.exit(WRONG_USE, f"{self.prog}: {' '.join(message.split())}; see {self.prog} --help\n")

    def _print_message(self, message: str, file: Any = None) -> None:
        """As argparse has it, but help and version that cannot be written are an error."""
        if file is sys.stdout:
            file.write(message)
        else:
            super()._print_message(message, file)


class _Version(argparse.Action):
    """Prints the version of the installed package, which takes a while to find out."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        """End with exit code 0."""
        from importlib.metadata import version

        print(f"canfb {version('canfb')}")
        parser.exit()


def build_parser(command: str | None = None) -> argparse.ArgumentParser:
    """The parser with all commands; or with the options of this one alone, its file alone imported."""
    parser = _Parser(
        prog="canfb",
        description="CANopen drive feedback module for sine/cosine encoders.",
        epilog=f"{examples_of('canfb')}\n\n'canfb COMMAND --help' lists options and examples of a command.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    add_commands(commands, command)
    return parser
