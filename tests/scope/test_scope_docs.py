"""docs/scope.md: its commands are understood, every option and task is there."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
from pathlib import Path

import pytest

from canfb.cli.main import build_parser
from canfb.scope import desk

PAGE = (Path(__file__).parents[2] / "docs" / "scope.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^canfb scope.*$", PAGE, re.M)


@pytest.mark.parametrize("command", COMMANDS)
def test_the_commands_are_understood(command: str) -> None:
    assert build_parser().parse_args(shlex.split(command)[1:]).command == "scope"


def test_every_option_is_there() -> None:
    with contextlib.redirect_stdout(io.StringIO()) as out, pytest.raises(SystemExit):
        build_parser().parse_args(["scope", "--help"])
    own = out.getvalue().partition("\noptions:")[2].partition("bus arguments")[0]
    options = set(re.findall(r"--[a-z-]+", own))
    assert {one for one in options if one not in PAGE} <= {"--help", "--debug", "--channel", "--ready-file"}


def test_every_task_is_there_with_its_option() -> None:
    rows = dict(re.findall(r"^\| ([\w ]+) \| `(--\w+)` \|", PAGE, re.M))
    assert rows == {task.label: "--write" if task.writes else "--sdo" for task in desk.TASKS}
