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
        (
            "try",
            "try_it",
            "a module, its encoder and its page on a private bus",
        ),
        (
            "plan",
            "plan_command",
            "what bit rate, SYNC rate, speed and acceleration allow",
        ),
        ("run", "run", "run the modules and encoder interfaces of a configuration on a bus"),
        (
            "simulate",
            "simulate",
            "simulate the encoder interface and its machine, a recording or a drive, on a bus",
        ),
        ("config", "config_file", "check a configuration, print an example, write a DCF"),
        (
            "monitor",
            "monitor",
            "watch modules live or in a log; --frames: each frame, --web: a page",
        ),
        ("why", "why", "why the position of a module is not valid; --bundle: one file for support"),
        ("node", "node_command", "who is on a bus; start, stop or reset nodes"),
        ("sdo", "sdo_command", "read, write or list objects of a node, by name or number"),
        ("calibrate", "calibrate", "measure the encoder, build its correction table and activate it"),
        (
            "commission",
            "commission",
            "limits of the supervision from the machine's motion",
        ),
        ("table", "table_command", "the correction table of a module: show, read, write, activate, clear"),
        ("backup", "backup_command", "table and all parameters of a module: save to a file, restore from it"),
        ("log", "log_command", "record the bus; put a recorded log through the same module"),
        ("use", "use", "the bus that commands use by default"),
    )
)
SUMMARIES = {entry.name: entry.summary for entry in COMMANDS}


def named_command(words: Sequence[str]) -> str:
    return next((word for word in words if not word.startswith("-")), "")


def add_commands(commands: Any, name: str | None = None) -> None:
    """Add all commands to argparse's sub-parsers; or ``name`` with its options, the others for the help."""
    for entry in COMMANDS:
        if name in (None, entry.name):
            import_module(f"canfb.cli.{entry.file}").register(commands)
        else:
            commands.add_parser(entry.name, help=entry.summary)


WRONG_USE = 2


class _Parser(argparse.ArgumentParser):
    """One line says what is wrong; options and arguments may be mixed."""

    _mixing = False

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse has it, but ``NODE --json CONFIG.yaml`` is what ``NODE CONFIG.yaml --json`` is."""
        if self._mixing or any(isinstance(action, argparse._SubParsersAction) for action in self._actions):
            return super().parse_known_args(args, namespace)
        self._mixing = True
        try:
            return self.parse_known_intermixed_args(args, namespace)
        finally:
            self._mixing = False

    def error(self, message: str) -> NoReturn:
        self.exit(WRONG_USE, f"{self.prog}: {' '.join(message.split())}; see {self.prog} --help\n")

    def _print_message(self, message: str, file: Any = None) -> None:
        """As argparse has it, but help and version that cannot be written are an error."""
        if file is sys.stdout:
            file.write(message)
        else:
            super()._print_message(message, file)


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from importlib.metadata import version

        print(f"canfb {version('canfb')}")
        parser.exit()


def build_parser(command: str | None = None) -> argparse.ArgumentParser:
    """The parser with all commands; or with this one alone, its file alone imported."""
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
