"""docs/monitor.md: its commands for logs run."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from canfb.cli.main import main
from replay_kit import live, session, write_log

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "monitor.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^    canfb (log .*)$", PAGE, re.M)


def test_its_commands_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pyarrow")
    monkeypatch.chdir(tmp_path)
    Path("feedback.yaml").write_text(
        "bus: {interface: virtual, channel: page}\nmodules: [{node_id: 32, encoder_interface: 16}]\n"
    )
    record, replay, folder = COMMANDS
    assert main(shlex.split(record.replace("--seconds 10", "--seconds 0.05"))) == 0
    write_log(Path("bus.log"), live(session(200))[0])
    assert main(shlex.split(replay)) == 0
    Path("month").mkdir()
    Path("bus.log").rename("month/bus.log")
    assert main(shlex.split(folder.replace("--workers 2", "--workers 1"))) == 0
    assert {path.name for path in Path().iterdir()} == {
        "feedback.yaml",
        "month",
        "month.parquet",
        "replay.html",
        "samples.csv",
    }
    assert "200 samples; faults: none" in capsys.readouterr().out
