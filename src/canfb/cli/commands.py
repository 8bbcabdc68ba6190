"""The commands of canfb: which file has each of them. A file is imported when its command is used.

So ``canfb --help`` imports none of them, and a command imports what it uses itself. To add a command:
write its file with ``register()``, and its line here; a test compares the summaries.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Any, NamedTuple


class CommandEntry(NamedTuple):
    """A command: its name, its file in this folder, and the summary for ``canfb --help``."""

    name: str
    file: str
    summary: str


COMMANDS = (
    CommandEntry(
        "demo", "demo", "start, track, calibrate, upload, verify and survive faults on an in-process bus"
    ),
    CommandEntry("try", "try_command", "a module, its encoder and its page on a private bus, in one command"),
    CommandEntry(
        "plan",
        "plan_command",
        "what bit rate, SYNC rate, speed and acceleration allow, before there is a machine",
    ),
    CommandEntry("run", "run", "run the feedback modules of a configuration on a bus"),
    CommandEntry(
        "interface",
        "interface_command",
        "run the encoder interface of a configuration, with an ADC, on a bus",
    ),
    CommandEntry("monitor", "monitor", "watch modules live, on a bus or in a log"),
    CommandEntry("dump", "dump_command", "show frames, PDOs of modules and interfaces decoded"),
    CommandEntry("scope", "scope", "watch and commission modules on a local web page"),
    CommandEntry(
        "simulate",
        "simulate",
        "simulate the encoder interface, with a motion, a recording or a drive, on a bus",
    ),
    CommandEntry("why", "why_command", "why the position of a module is not valid, and what brings it back"),
    CommandEntry(
        "diagnose",
        "diagnose_command",
        "write one file for whoever is to help: versions, settings, objects, log",
    ),
    CommandEntry("reset", "reset_command", "reset and start a module, at standstill only"),
    CommandEntry("bus", "bus_command", "who is on a bus"),
    CommandEntry("nmt", "nmt_command", "start, stop or reset nodes"),
    CommandEntry("sdo", "sdo_command", "read or write one object of a node, by name or number"),
    CommandEntry(
        "calibrate",
        "calibrate",
        "measure the encoder, build its correction table, activate it and save it",
    ),
    CommandEntry(
        "commission",
        "commission",
        "propose the limits of the supervision from the machine's own motion, and set them",
    ),
    CommandEntry(
        "table",
        "table_command",
        "show, upload, download, activate or clear the correction table of a module",
    ),
    CommandEntry("backup", "backup_command", "write table and all parameters of a module to a file (YAML)"),
    CommandEntry(
        "restore",
        "backup_command",
        "write a backup to a module, prove it, or put back what was before",
    ),
    CommandEntry("record", "record", "write a log of the bus"),
    CommandEntry("replay", "replay", "put a recorded bus log through the same module"),
    CommandEntry("config", "config_file", "check a configuration, print an example, write a DCF"),
)


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
