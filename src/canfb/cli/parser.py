"""The parser of the command line."""

from __future__ import annotations

import argparse
import sys
from typing import Any, NoReturn

from canfb.cli.commands import add_commands
from canfb.cli.examples import examples_of

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
