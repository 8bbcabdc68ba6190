"""The parser of the command line, and the file of each command, which is imported when the command is used.

So ``canfb --help`` imports none of them, and a command imports only what it uses. To add a command:
write its file with ``register()``, and a line here.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NoReturn

EXAMPLES = {
    "canfb": """
  canfb demo                                   a complete demonstration, without a bus
  canfb try                                    a module to watch and talk to, without hardware
  canfb config example > feedback.yaml         a configuration to start from
  canfb run feedback.yaml                      run its module on its bus
  canfb simulate feedback.yaml --rate 100      simulate encoder interface and machine, produce SYNC""",
    "canfb try": """
  canfb try
  canfb try --story --out pictures             (or: canfb demo)
  canfb try --rate 500 --no-page
  canfb try --json --ready-file try.ready""",
    "canfb run": """
  canfb run feedback.yaml
  canfb run feedback.yaml -i socketcan -c can0
  canfb run interface.yaml -i udp_multicast -c 239.74.163.2 --ready-file interface.ready""",
    "canfb monitor": """
  canfb monitor -i socketcan -c can0
  canfb monitor 0x20 0x21 -i socketcan -c can0 -b 500000 --sdo
  canfb monitor --config feedback.yaml --per-revolution '5 mm'
  canfb monitor --log drive.asc --json
  canfb monitor 0x20 --frames -i socketcan -c can0 --pdo --seconds 1
  canfb monitor --web feedback.yaml --sdo""",
    "canfb simulate": """
  canfb simulate feedback.yaml --rate 100
  canfb simulate feedback.yaml 0x20 --rate 500 --rpm 300
  canfb simulate feedback.yaml --rate 500 --samples tracks.csv --columns b,a --mid-scale 8192""",
    "canfb why": """
  canfb why 0x20 -i socketcan -c can0
  canfb why 0x20 --config feedback.yaml --json
  canfb why --status 0x0006
  canfb why feedback.yaml --bundle --out machine.json""",
    "canfb node reset": """
  canfb node reset 0x20 -i socketcan -c can0
  canfb node reset all --config feedback.yaml""",
    "canfb node list": """
  canfb node list -i socketcan -c can0
  canfb node list --config feedback.yaml --json""",
    "canfb node start": """
  canfb node start all -i socketcan -c vcan0
  canfb node start 0x10 0x20 --config feedback.yaml""",
    "canfb sdo read": """
  canfb sdo read 0x20 "residual limit" -i socketcan -c can0
  canfb sdo read 0x20 supervision --config feedback.yaml
  canfb sdo read 0x20 2011:01 --json --config feedback.yaml""",
    "canfb sdo write": """
  canfb sdo write 0x20 "samples to coast" 4 --config feedback.yaml
  canfb sdo write 0x20 1010:01 save --config feedback.yaml
  canfb sdo write 5 6083 1000 --eds drive.eds --config feedback.yaml""",
    "canfb calibrate": """
  canfb calibrate 0x20 -i socketcan -c can0 --out measured
  canfb calibrate feedback.yaml --save
  canfb calibrate feedback.yaml --dry-run --json
  canfb calibrate feedback.yaml --check
  canfb calibrate feedback.yaml --speeds 61,1500,3000 --out measured
  canfb calibrate --samples measured/samples.npz --out again""",
    "canfb commission": """
  canfb commission 0x20 -i socketcan -c can0 --out limits
  canfb commission feedback.yaml --seconds 120 --acceleration 400
  canfb commission feedback.yaml --write --save""",
    "canfb table show": """
  canfb table show 0x20 -i socketcan -c can0
  canfb table show measured/table.yaml""",
    "canfb table write": """
  canfb table write 0x20 measured/table.yaml --config feedback.yaml
  canfb table write 0x20 measured/table.yaml --activate --save --config feedback.yaml""",
    "canfb table read": """
  canfb table read 0x20 table.yaml --config feedback.yaml""",
    "canfb table activate": """
  canfb table activate 0x20 --save --config feedback.yaml""",
    "canfb table clear": """
  canfb table clear 0x20 --config feedback.yaml""",
    "canfb backup save": """
  canfb backup save 0x20 left-drive.yaml --config feedback.yaml""",
    "canfb backup restore": """
  canfb backup restore left-drive.yaml --dry-run --config feedback.yaml
  canfb backup restore left-drive.yaml --preop --save --config feedback.yaml""",
    "canfb plan": """
  canfb plan feedback.yaml
  canfb plan feedback.yaml --rate 2000 --rpm 3000 --acceleration 500 --times
  canfb plan -b 500000 --rate 1000 --jitter 20us --rpm 1500 --acceleration 120 --modules 4 --json""",
    "canfb log record": """
  canfb log record bus.log -i socketcan -c can0
  canfb log record bus.blf --config feedback.yaml --seconds 60
  canfb log record week.log --config feedback.yaml --max-size 100M""",
    "canfb log replay": """
  canfb log replay bus.log --config feedback.yaml --report replay.html
  canfb log replay bus.blf --config feedback.yaml --table new.yaml --set coast_samples=5
  canfb log replay bus.log 0x20 --encoder-interface 0x10 --out samples.parquet
  canfb log replay month --config feedback.yaml --out month.parquet --workers 4""",
    "canfb use": """
  canfb use -i socketcan -c can0
  canfb use
  canfb use --forget""",
    "canfb config": """
  canfb config example > feedback.yaml
  canfb config check feedback.yaml
  canfb config dcf feedback.yaml""",
    "canfb config check": """
  canfb config check feedback.yaml""",
    "canfb config example": """
  canfb config example > feedback.yaml""",
    "canfb config dcf": """
  canfb config dcf feedback.yaml 0x20 --out left.dcf --concise left.bin
  canfb config dcf 0x20 -i socketcan -c can0""",
}


def examples_of(command: str) -> str | None:
    return f"examples:{EXAMPLES[command]}" if command in EXAMPLES else None


# The commands by name: file in this folder, and summary for ``canfb --help``.
COMMANDS = {
    "try": ("try_it", "a module, its encoder and its page on a private bus"),
    "plan": ("plan_command", "what bit rate, SYNC rate, speed and acceleration allow"),
    "run": ("run", "run the modules and encoder interfaces of a configuration on a bus"),
    "simulate": (
        "simulate",
        "simulate the encoder interface and its machine, a recording or a drive, on a bus",
    ),
    "config": ("config_file", "check a configuration, print an example, write a DCF"),
    "monitor": ("monitor", "watch modules live or in a log; --frames: each frame, --web: a page"),
    "why": ("why", "why the position of a module is not valid; --bundle: one file for support"),
    "node": ("node_command", "who is on a bus; start, stop or reset nodes"),
    "sdo": ("sdo_command", "read, write or list objects of a node, by name or number"),
    "calibrate": ("calibrate", "measure the encoder, build its correction table and activate it"),
    "commission": ("commission", "choose limits of the supervision from the machine's motion"),
    "table": ("table_command", "the correction table of a module: show, read, write, activate, clear"),
    "backup": ("backup_command", "table and all parameters of a module: save to a file, restore from it"),
    "log": ("log_command", "record the bus; replay a log through the same module"),
    "use": ("use", "the bus that commands use by default"),
}


def named_command(words: Sequence[str]) -> str:
    return next((word for word in words if not word.startswith("-")), "")


WRONG_USE = 2


class _Parser(argparse.ArgumentParser):
    """Reports an error in one line; accepts options and arguments in any order."""

    _mixing = False

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As in argparse, but ``NODE --json CONFIG.yaml`` equals ``NODE CONFIG.yaml --json``."""
        if self._mixing or any(isinstance(action, argparse._SubParsersAction) for action in self._actions):
            return super().parse_known_args(args, namespace)
        self._mixing = True
        self._negative_number_matcher = re.compile(r"-\.?\d")  # -1e-05 and -0x10 are values, too
        try:
            return self.parse_known_intermixed_args(args, namespace)
        finally:
            self._mixing = False

    def error(self, message: str) -> NoReturn:
        self.exit(WRONG_USE, f"{self.prog}: {' '.join(message.split())}; see {self.prog} --help\n")

    def _print_message(self, message: str, file: Any = None) -> None:
        """As in argparse, but a failure to write help or version is an error."""
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
    """The parser of all commands, or only of ``command``, importing only its file."""
    parser = _Parser(
        prog="canfb",
        description="CANopen drive feedback module for sine/cosine encoders.",
        epilog=f"{examples_of('canfb')}\n\n'canfb COMMAND --help' lists options and examples of a command.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, (file, summary) in COMMANDS.items():
        if command in (None, name):
            import_module(f"canfb.cli.{file}").register(commands)
        else:  # only for the help
            commands.add_parser(name, help=summary)
    return parser
