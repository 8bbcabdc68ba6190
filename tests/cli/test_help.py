"""Examples in each help, which can be typed as they stand."""

from __future__ import annotations

import re
import shlex

import pytest

from canfb.cli.main import build_parser, main

COMMANDS = [
    "",
    "demo",
    "plan",
    "run",
    "simulate",
    "calibrate",
    "commission",
    "record",
    "replay",
    "config",
    "config check",
    "config example",
    "config dcf",
    "table show",
    "table upload",
    "table download",
    "table activate",
    "table clear",
    "backup",
    "why",
    "diagnose",
    "interface",
    "reset",
    "dump",
    "bus scan",
    "sdo read",
    "sdo write",
    "restore",
]


@pytest.mark.parametrize("command", COMMANDS)
def test_the_examples_of_a_help_are_good(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*command.split(), "--help"]) == 0
    _, _, text = capsys.readouterr().out.partition("examples:\n")
    lines = re.findall(r"^  (canfb .*?)(?:   .*| > .*)?$", text, re.MULTILINE)
    assert lines
    for line in lines:
        words = shlex.split(line)
        assert line.startswith(f"canfb {command}".strip())
        assert build_parser().parse_args(words[1:]).command
