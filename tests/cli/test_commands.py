"""The table of commands, their help and its examples, and what older lines are called now."""

import argparse
import json
import re
import shlex
from pathlib import Path
from typing import Any

import pytest

from canfb.cli import commands as table
from canfb.cli.aliases import current
from canfb.cli.commands import COMMANDS, EXAMPLES, build_parser, named_command
from commands import Command
from folding import each
from processes import python


def subparsers(parser: argparse.ArgumentParser) -> Any:
    (found,) = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return found


def test_every_command_is_in_the_table_as_the_files_register_it() -> None:
    shown = {choice.dest: choice.help for choice in subparsers(build_parser())._choices_actions}
    assert shown == {name: summary for name, (_, summary) in COMMANDS.items()}
    folder = Path(table.__file__).parent
    registering = {file.stem for file in folder.glob("*.py") if "\ndef register(" in file.read_text()}
    assert {file for file, _ in COMMANDS.values()} == registering


@pytest.mark.parametrize("name", COMMANDS)
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
    importlib.import_module("canfb.cli.commands").build_parser(name)
    found[name] = [one.rpartition(".")[2] for one in sys.modules if one.startswith("canfb.cli.")]
print(json.dumps(found))
"""


def test_the_file_of_a_command_imports_that_of_no_other() -> None:
    found = json.loads(python("-c", IMPORTING, *COMMANDS).stdout)
    loaded = {name: {file for file, _ in COMMANDS.values()} & {*files} for name, files in found.items()}
    assert loaded == {name: {file} for name, (file, _) in COMMANDS.items()}


@each("line, name", [
    ("", ""), ("--help", ""), ("run x.yaml", "run"), ("--debug run x.yaml", "run"), ("-- run", "run"),
    ("demo --out run", "demo"),
])  # fmt: skip
def test_the_command_of_a_line(line: str, name: str) -> None:
    assert named_command(line.split()) == name


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_examples_of_a_help_are_good(name: str, command: Command) -> None:
    _, _, text = command(f"{name.removeprefix('canfb')} --help").out.partition("examples:\n")
    lines = re.findall(r"^  (canfb .*?)(?:   .*| > .*)?$", text, re.MULTILINE)
    assert lines
    for line in lines:
        assert line.startswith(name) or line == "canfb demo"
        if line != "canfb demo":
            assert build_parser().parse_args(shlex.split(line)[1:]).command


def test_every_command_has_examples() -> None:
    assert {name.split()[1] for name in EXAMPLES if " " in name} == {*COMMANDS}


LINES = {
    "dump 0x20 --log x.asc --pdo": "monitor --frames 0x20 --log x.asc --pdo",
    "--debug scope x.yaml": "--debug monitor --web x.yaml", "scope --demo": "try",
    "diagnose feedback.yaml --answer-within 2": "why --bundle feedback.yaml --timeout 2",
    "bus scan -c can0": "node list -c can0", "why 5 --answer-within=2": "why 5 --timeout=2",
    "nmt start all": "node start all", "nmt reset-comm 5": "node reset --communication 5",
    "reset 0x20 --force": "node reset 0x20 --force", "record bus.log": "log record bus.log",
    "replay bus.log --module 5": "log replay 5 bus.log", "interface adc.yaml": "run adc.yaml",
    "table upload 32 t.yaml": "table write 32 t.yaml", "table download 32 t.yaml": "table read 32 t.yaml",
    "backup 0x20 b.yaml": "backup save 0x20 b.yaml",
    "restore b.yaml --node=0x21": "backup restore 0x21 b.yaml",
    "calibrate f.yaml --module 0x20 --sync 100 --no-save": "calibrate 0x20 f.yaml --rate 100",
    "calibrate --samples a.csv --rate 1000": "calibrate --samples a.csv --sample-rate 1000",
    "calibrate --rate=1000 --samples=a.csv": "calibrate --sample-rate=1000 --samples=a.csv",
    "calibrate 5 --rate 1000": "calibrate 5 --rate 1000",
    "commission --module 5 --sync 100": "commission 5 --rate 100",
    "simulate f.yaml --module 33": "simulate 33 f.yaml", "config dcf --node 3": "config dcf 3",
    "monitor --rate 5": "monitor --updates 5", "try --no-scope": "try --no-page",
    "demo --json": "try --story --json",
}  # fmt: skip


@pytest.mark.parametrize("old", LINES)
def test_an_old_line_is_a_new_one(old: str) -> None:
    words, said = current(old.split())
    assert " ".join(words) == LINES[old]
    assert build_parser().parse_args(words).command in COMMANDS
    assert not said or said.startswith("'canfb ")
    assert current(words) == (words, "")


def test_the_line_goes_to_stderr(command: Command) -> None:
    assert command("nmt fly", code=2).err.startswith("canfb: 'canfb nmt' is now 'canfb node'\n")
