"""Completion in a shell: what canfb answers, and what bash makes of it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from canfb.cli import completion
from canfb.cli.commands import COMMANDS
from canfb.cli.completion import asked_words, can_interfaces
from canfb.cli.main import main
from folding import each
from processes import python
from tools.site.reference import COMMANDS_TEXT

CONFIG = "bus: {interface: virtual, channel: x}\nmodules: [{node_id: 33, encoder_interface: 17}]\n"
BASH = shutil.which("bash")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "feedback.yaml").write_text(CONFIG)
    (tmp_path / "wrong.yaml").write_text("modules: 5\n")
    (tmp_path / "tracks.csv").write_text("\n")
    (tmp_path / "measured").mkdir()
    return tmp_path


EACH_LINE = """
import os, sys
import can, numpy  # once, not for each line
from canfb.cli.main import main
for line in sys.argv[1:]:
    if (pid := os.fork()) == 0:  # argcomplete ends the process
        os.environ |= {"COMP_LINE": line, "COMP_POINT": str(len(line))}
        os._exit(main([]))
    assert os.waitpid(pid, 0)[1] == 0, line
    with open("answer") as answer:
        print(*answer.read().split(), flush=True)
"""


def completed(folder: Path, *lines: str) -> list[set[str]]:
    """What canfb gives the shell for these lines, with the cursor at their ends."""
    environment = {
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_STDOUT_FILENAME": "answer",
        "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_SUPPRESS_SPACE": "1",
        "COMP_TYPE": "9",
    }
    done = python("-c", EACH_LINE, *lines, cwd=folder, env=os.environ | environment, timeout=600)
    assert (done.returncode, done.stderr) == (0, "")
    return [set(line.split()) for line in done.stdout.splitlines()]


# A line: all answers, or (with "...") some of them; then what is no answer.
ANSWERS = {
    "canfb ": (f"... {' '.join(COMMANDS)}", ""),
    "canfb si": ("simulate", ""),
    "canfb config check --": ("--debug --help", ""),
    "canfb config e": ("example", ""),
    "canfb run x -i socketcan": ("socketcan socketcand", ""),
    "canfb run ": ("... feedback.yaml wrong.yaml", "tracks.csv"),
    "canfb try --out ": ("measured/", ""),
    "canfb calibrate --samples ": ("... tracks.csv", ""),
    "canfb node start --config feedback.yaml ": ("... all 0x11 0x21", ""),
    "canfb calibrate --config feedback.yaml 0x2": ("0x21", ""),
    "canfb node start --config wrong.yaml ": ("...", "0x21"),
    "canfb calibrate --config feedback.yaml ": ("...", "all"),
}


def test_a_line_is_completed_by_what_fits(folder: Path) -> None:
    for (line, (wanted, never)), found in zip(ANSWERS.items(), completed(folder, *ANSWERS), strict=True):
        some = wanted.startswith("...")
        words = {*wanted.removeprefix("...").split()}
        assert found >= words if some else found == words, line
        assert not found & {*never.split()}, line


def test_channels_are_the_can_interfaces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, kind in (("eth0", "1"), ("vcan0", "280"), ("can1", "280")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "type").write_text(f"{kind}\n")
    monkeypatch.setattr(completion, "NETWORK", tmp_path)
    assert can_interfaces() == ["can1", "vcan0"]
    monkeypatch.setattr(completion, "NETWORK", tmp_path / "none")
    assert can_interfaces() == []


@each("environment, words", [
    ({"COMP_LINE": "canfb run x", "COMP_POINT": "9", "_ARGCOMPLETE": "1"}, ["run"]),
    ({"COMP_LINE": "python3 -m canfb run", "COMP_POINT": "20", "_ARGCOMPLETE": "3"}, ["run"]),
    ({"COMP_LINE": "canfb", "COMP_POINT": "5", "_ARGCOMPLETE": "1"}, []),
    ({"COMP_LINE": "canfb run 'a", "COMP_POINT": "?", "_ARGCOMPLETE": "?"}, ["run", "'a"]),
    ({}, []),
])  # fmt: skip
def test_words_up_to_the_cursor(environment: dict[str, str], words: list[str]) -> None:
    assert asked_words(environment) == words


def test_without_argcomplete_nothing_is_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "argcomplete", None)
    monkeypatch.setenv("_ARGCOMPLETE", "1")
    monkeypatch.setenv("COMP_LINE", "canfb ")
    assert main([]) == 1
    assert capsys.readouterr() == ("", "")


@pytest.mark.skipif(BASH is None, reason="no bash")
def test_bash_completes_as_the_page_says(folder: Path) -> None:
    activation = 'eval "$(register-python-argcomplete canfb)"'
    assert activation in COMMANDS_TEXT
    script = f"""
        {activation}
        COMP_LINE='canfb config ch' COMP_POINT=15 COMP_TYPE=9 COMP_WORDS=(canfb config ch) COMP_CWORD=2
        $(complete -p canfb | sed 's/.*-F \\([^ ]*\\).*/\\1/') canfb ch config
        echo "${{COMPREPLY[@]}}"
    """
    scripts = str(Path(sys.executable).parent)
    environment: dict[str, Any] = os.environ | {"PATH": f"{scripts}:{os.environ['PATH']}"}
    done = subprocess.run(
        [BASH or "", "-c", script], env=environment, capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.stdout.strip(), done.stderr) == ("check", "")
