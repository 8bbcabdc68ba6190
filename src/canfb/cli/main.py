"""The command line: ``canfb COMMAND``.

Exit codes: 0 done, 1 the job failed, 2 wrong use or configuration. An error is one line
on stderr; ``--debug`` shows the traceback before it, with the same exit code.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import logging
import os
import shlex
import sys
import traceback
from collections.abc import Sequence
from typing import Any, NoReturn

from canfb.cli.commands import add_commands, named_command
from canfb.cli.examples import examples_of
from canfb.cli.printing import printed_log
from canfb.errors import CanfbError, ConfigError

FAILED, WRONG_USE = 1, 2
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


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


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; the exit code. Without a command: the help."""
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        code = _run(arguments or ["--help"])
        sys.stdout.flush()
    except BrokenPipeError:  # the reader has gone, as in `canfb demo | head`
        _drop_output()
        return FAILED
    except OSError as error:
        if "--debug" in arguments:
            traceback.print_exc()
        is_output = error.filename is None and error.errno in FULL
        where = "cannot write the output: " if is_output else f"{error.filename}: " * bool(error.filename)
        print(f"canfb: {where}{error.strerror or error}", file=sys.stderr)
        _drop_output()
        return FAILED
    return code


def _run(arguments: Sequence[str]) -> int:
    parser = build_parser(named_command(arguments))
    try:
        options = parser.parse_args(arguments)
    except SystemExit as end:  # argparse has said what it has to say
        return int(end.code or 0)
    options.line = shlex.join(["canfb", *(sys.argv[1:] if arguments is None else arguments)])  # for reports
    # python-can logs what it raises as well; an error is one line here.
    logging.basicConfig(level=logging.INFO if options.debug else logging.CRITICAL)
    try:
        with printed_log():
            return int(options.action(options))
    except KeyboardInterrupt:
        return FAILED
    except CanfbError as error:
        if options.debug:
            traceback.print_exc()
        print(f"canfb: {error}", file=sys.stderr)
        return WRONG_USE if isinstance(error, ConfigError) else FAILED


def _drop_output() -> None:
    """What is still to be written goes nowhere, or Python would complain of it at its end."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
