"""Examples in each help, which can be typed as they stand."""

from __future__ import annotations

import re
import shlex

import pytest

from canfb.cli import examples
from canfb.cli.commands import COMMANDS
from canfb.cli.main import build_parser, main


@pytest.mark.parametrize("command", examples._EXAMPLES)
def test_the_examples_of_a_help_are_good(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*command.split()[1:], "--help"]) == 0
    _, _, text = capsys.readouterr().out.partition("examples:\n")
    lines = re.findall(r"^  (canfb .*?)(?:   .*| > .*)?$", text, re.MULTILINE)
    assert lines
    for line in lines:
        assert line.startswith(command) or line == "canfb demo"
        if line != "canfb demo":
            assert build_parser().parse_args(shlex.split(line)[1:]).command


def test_every_command_has_examples() -> None:
    assert {name.split()[1] for name in examples._EXAMPLES if " " in name} == {one.name for one in COMMANDS}
