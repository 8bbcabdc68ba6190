"""docs/drive-network without SocketCAN, as its page has it: on udp_multicast, with ``--pace sync``."""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest
import yaml

from processes import Process

FOLDER = Path(__file__).parents[2] / "docs" / "drive-network"
PAGE = (FOLDER / "README.md").read_text(encoding="utf-8")
PATIENCE_S = 120.0


@pytest.fixture
def started() -> Iterator[list[Process]]:
    """Processes that are ended after the test."""
    processes: list[Process] = []
    yield processes
    for process in processes:
        process.stop()


def written_for(words: dict[str, Any], folder: Path) -> None:
    """Both YAML files with this bus, as the page says."""
    assert "bus: {interface: udp_multicast, channel: 239.74.163.2}` into both YAML files" in PAGE
    for name in ("feedback.yaml", "network.yaml"):
        text = (FOLDER / name).read_text(encoding="utf-8")
        bus = f"bus: {yaml.safe_dump(words, default_flow_style=True).strip()}"
        text, count = re.subn(r"^bus: .*$", bus, text, count=1, flags=re.M)
        assert count == 1
        (folder / name).write_text(text.replace("../../eds", str(FOLDER.parents[1] / "eds")))


def test_two_moves_and_an_alarm_between_them(
    multicast_bus: can.BusABC, multicast_words: dict[str, Any], tmp_path: Path, started: list[Process]
) -> None:
    (line,) = re.findall(r"`(canfb simulate feedback.yaml --pace sync)` in place", PAGE)
    written_for(multicast_words, tmp_path)
    shutil.copytree(
        FOLDER, tmp_path / "programs", ignore=shutil.ignore_patterns("*.yaml", "*.md", "__pycache__")
    )
    config = str(tmp_path / "feedback.yaml")
    for words in (["run", config], line.replace("feedback.yaml", config).split()[1:]):
        started.append(Process((sys.executable, "-m", "canfb", *words), PATIENCE_S))
        started[-1].wait_for("end with Ctrl-C")
    master = (str(tmp_path / "programs" / "master.py"), str(tmp_path / "network.yaml"), "--provoke-alarm")
    started.append(story := Process((sys.executable, *master), PATIENCE_S))
    story.wait()
    assert [process.stop() for process in started][-1] == 0, "\n".join(map(str, started))
    said = "\n".join(story.lines)
    positions = re.findall(r"position          drive (-?[0-9.]+), module (-?[0-9.]+)", said)
    for revolutions, pair in zip((1.0, -1.0), positions, strict=True):
        assert [float(one) for one in pair] == pytest.approx([revolutions, revolutions], abs=1e-3)
    assert said.index("is in FAULT") < said.index("recovered:")
