"""docs/drive-network as it stands there: module, simulated machine and master are three processes."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path

import can
import pytest
from network import wait_for_boot_up
from pace import Pace

from processes import Process

FOLDER = Path(__file__).parents[2] / "docs" / "drive-network"


def figure(lines: list[str], what: str, move: int) -> float:
    """A number of the report of the master, after these words, of the n-th move."""
    return float(re.findall(rf"{what} (-?[0-9.]+)", "\n".join(lines))[move])


def test_two_moves_and_an_alarm_between_them(
    process: Callable[..., Process], command: Callable[..., Process], can_bus: can.BusABC, pace: Pace
) -> None:
    config = str(FOLDER / "feedback.yaml")
    # A test must pass on a computer that is busy with others: slow motion.
    processes = process("run", config), process("simulate", config, "--pace", "sync")
    wait_for_boot_up(can_bus, pace, 0x20, 0x10, 0x30)
    master = command(
        sys.executable, str(FOLDER / "master.py"), str(FOLDER / "network.yaml"), "--provoke-alarm"
    )
    assert master.wait() == 0, str(master)
    lines = master.lines
    for move, revolutions in enumerate((1.0, -1.0)):
        assert 1e-5 < figure(lines, "rms", move) < 5e-3
        assert figure(lines, "peak", move) < 2e-2
        assert figure(lines, "position          drive", move) == pytest.approx(revolutions, abs=1e-3)
        assert figure(lines, ", module", move) == pytest.approx(revolutions, abs=1e-3)
        assert figure(lines, "at most", move) < 2e-2
    said = "\n".join(lines)
    assert "EMCY of module (20h): 7300h" in said
    assert "EMCY of drive (30h): 7305h" in said
    assert "is in FAULT" in said
    assert "FF1C" not in said, "the drive's own encoder goes with the position"
    assert said.index("is in FAULT") < said.index("recovered:")
    for one in processes:
        assert one.stop() == 0
    assert any("residual 0, amplitude 0" in line for line in processes[0].lines)
