"""docs/scope.md: its commands are understood, every option and task is there, its limits are true."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
from pathlib import Path

import pytest

from canfb.bus import scope_server
from canfb.cli.main import build_parser
from canfb.monitoring.module_model import TRACKS
from canfb.scope import desk, gate, scope_page, traces

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


def test_the_limits_are_those_of_the_program() -> None:
    assert f"last {TRACKS} ADC PDOs" in PAGE
    assert f"last {traces.SAMPLES} samples" in PAGE
    assert traces.LONGEST_S == 120.0
    assert f"code, {gate.CODE_LENGTH} letters | in the terminal only" in PAGE
    assert f"{gate.MOST_WRONG} wrong codes end all writing" in PAGE
    assert f"valid for {scope_server.TICKET_S} s | one websocket, once" in PAGE
    assert f"at most {scope_page.LARGEST_FILE:,} bytes".replace(",", " ") in PAGE
    assert f"{scope_server.MOST_PAGES} pages can be open at once" in PAGE
    assert f"more than {scope_page.LARGEST_MESSAGE:,} bytes, or".replace(",", " ", 1) in PAGE
    assert f"heads of at most {scope_server.LARGEST_HEAD >> 10} KiB" in PAGE
    assert f"after {2 * scope_server.PING_S:.0f} s without an answer" in PAGE
    assert f"token, {8 * gate.TOKEN_BYTES} bits" in PAGE
