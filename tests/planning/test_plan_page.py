"""docs/plan.md: its commands run, and its output is theirs."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from canfb.cia301.frame import frame_bits
from canfb.cli.main import main

PAGE = (Path(__file__).parents[2] / "docs" / "plan.md").read_text(encoding="utf-8")
PAGE = PAGE.partition("\n## The SYNC rate")[0]
BLOCKS = [block.splitlines() for block in re.findall(r"```sh\n(.*?)```", PAGE, re.S)]


def test_the_output_of_the_first_command(capsys: pytest.CaptureFixture[str]) -> None:
    ((line,), *_) = BLOCKS
    (shown, *_) = re.findall(r"```text\n(.*?)```", PAGE, re.S)
    assert main(shlex.split(line)[1:]) == 1
    assert capsys.readouterr().out == shown


def test_sample_times_remove_the_limit(capsys: pytest.CaptureFixture[str]) -> None:
    (line,) = BLOCKS[1]
    assert main(shlex.split(line)[1:]) == 0
    assert "the plan holds" in capsys.readouterr().out


def test_several_samples(capsys: pytest.CaptureFixture[str]) -> None:
    shown = re.findall(r"```text\n(.*?)```", PAGE, re.S)[1:]
    for (line,), part, code in zip(BLOCKS[3:], shown, (1, 0), strict=True):
        assert main(shlex.split(line)[1:]) == code
        assert part in capsys.readouterr().out


def test_the_commands_with_a_configuration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    example, *plans = BLOCKS[2]
    assert example.endswith("> feedback.yaml")
    assert main(["config", "example"]) == 0
    Path("feedback.yaml").write_text(capsys.readouterr().out)
    for line in plans:
        assert main(shlex.split(line)[1:]) == 0, line


def test_the_length_of_a_frame() -> None:
    (formula,) = re.findall(r"\| (47 \+ .*?) bits", PAGE)
    for n in range(9):
        assert frame_bits(n) == 47 + 8 * n + (34 + 8 * n - 1) // 4
    assert formula == "47 + 8 n + floor((34 + 8 n - 1) / 4)"
