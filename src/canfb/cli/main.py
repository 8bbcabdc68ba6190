"""The command line: ``canfb COMMAND``.

Exit codes: 0 done, 1 the job failed, 2 wrong use or configuration. An error is one line
on stderr; ``--debug`` shows the traceback.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
from collections.abc import Sequence
from importlib.metadata import version
from typing import NoReturn

from canfb.cli import calibrate, config, demo, nmt, run, simulate
from canfb.errors import CanfbError, ConfigError

DONE, FAILED, WRONG_USE = 0, 1, 2
COMMANDS = (demo, run, simulate, nmt, calibrate, config)


class _Parser(argparse.ArgumentParser):
    """Says in one line what is wrong, without the list of all options."""

    def error(self, message: str) -> NoReturn:
        """End with exit code 2."""
        self.exit(WRONG_USE, f"{self.prog}: {' '.join(message.split())}; see {self.prog} --help\n")


def build_parser() -> argparse.ArgumentParser:
    """The parser with all commands."""
    parser = _Parser(prog="canfb", description="CANopen drive feedback module for sine/cosine encoders.")
    parser.add_argument("--version", action="version", version=f"canfb {version('canfb')}")
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for module in COMMANDS:
        module.register(commands)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; the exit code."""
    parser = build_parser()
    try:
        options = parser.parse_args(arguments)
    except SystemExit as end:  # argparse has said what it has to say
        return int(end.code or 0)
    # python-can logs what it raises as well; an error is one line here.
    logging.basicConfig(level=logging.INFO if options.debug else logging.CRITICAL)
    try:
        return int(options.action(options))
    except KeyboardInterrupt:
        return FAILED
    except BrokenPipeError:  # the reader has gone, as in `canfb demo | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except CanfbError as error:
        if options.debug:
            raise
        print(f"canfb: {error}", file=sys.stderr)
        return WRONG_USE if isinstance(error, ConfigError) else FAILED
