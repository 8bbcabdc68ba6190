"""The table of commands: a name, a summary, and a file that is imported when its command is used."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from canfb.cli import commands as table
from canfb.cli.commands import COMMANDS, named_command
from canfb.cli.main import build_parser

NAMES = [entry.name for entry in COMMANDS]


def subparsers(parser: argparse.ArgumentParser) -> Any:
    (found,) = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return found


def summaries(parser: argparse.ArgumentParser) -> dict[str, str | None]:
    return {choice.dest: choice.help for choice in subparsers(parser)._choices_actions}


def test_names_and_summaries_are_those_that_the_files_register() -> None:
    assert summaries(build_parser()) == {entry.name: entry.summary for entry in COMMANDS}


def test_every_command_is_in_the_table() -> None:
    folder = Path(table.__file__).parent
    registering = {file.stem for file in folder.glob("*.py") if "\ndef register(" in file.read_text()}
    assert {entry.file for entry in COMMANDS} == registering
    assert len(set(NAMES)) == len(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_one_command_alone_has_its_options_and_the_help_of_all(name: str) -> None:
    whole, part = build_parser(), build_parser(name)
    assert part.format_help() == whole.format_help()
    assert subparsers(part).choices[name].format_help() == subparsers(whole).choices[name].format_help()


# Each command begins with no file of canfb.cli loaded; what those load besides stays, or it takes 20 s.
IMPORTING = """\
import importlib, json, sys
found = {}
for name in sys.argv[1:]:
    for module in [one for one in sys.modules if one.startswith("canfb.cli.")]:
        del sys.modules[module]
    importlib.import_module("canfb.cli.main").build_parser(name)
    found[name] = [one.rpartition(".")[2] for one in sys.modules if one.startswith("canfb.cli.")]
print(json.dumps(found))
"""


def test_the_file_of_a_command_imports_that_of_no_other() -> None:
    done = subprocess.run(
        [sys.executable, "-c", IMPORTING, *NAMES], capture_output=True, text=True, timeout=60, check=True
    )
    loaded = {
        name: {entry.file for entry in COMMANDS} & {*files} for name, files in json.loads(done.stdout).items()
    }
    assert loaded == {entry.name: {entry.file} for entry in COMMANDS}


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("", ""),
        ("--help", ""),
        ("run x.yaml", "run"),
        ("--debug run x.yaml", "run"),
        ("-- run", "run"),
        ("demo --out run", "demo"),
    ],
)
def test_the_command_of_a_line(line: str, name: str) -> None:
    assert named_command(line.split()) == name
