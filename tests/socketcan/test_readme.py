"""The first session of docs/vcan.md, pasted into a shell, and the master in Python of docs/first-hour.md."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import can
import pytest

from documentation import blocks, page
from judged_session import check, new_judge


def python_block(word: str) -> str:
    (found,) = [block for block in blocks(page("first-hour"), "python") if word in block]
    return found


@pytest.mark.usefixtures("can_utils")
def test_the_first_session_can_be_pasted(can_bus: can.BusABC, tmp_path: Path) -> None:
    (session,) = [block for block in blocks(page("vcan"), "sh") if "candump" in block]
    patient = "import canopen\ncanopen.sdo.SdoClient.RESPONSE_TIMEOUT = 30.0\n"
    (tmp_path / "master.py").write_text(patient + python_block("import canopen"))
    # Both commands are background jobs with the same ends as in a terminal.
    script = "set -m\n" + "\n".join([session, "python master.py", "kill %1 %2", "wait"])
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    judge = new_judge()
    with (tmp_path / "out.txt").open("w+") as out, (tmp_path / "err.txt").open("w+") as err:
        running = subprocess.Popen(
            ["bash", "-c", script], cwd=tmp_path, env=environment, stdout=out, stderr=err
        )
        deadline = time.monotonic() + 300.0
        while running.poll() is None and time.monotonic() < deadline:
            message = can_bus.recv(0.1)
            if message is not None:
                judge.take(message.arbitration_id, bytes(message.data), message.timestamp)
        running.kill()
        running.wait()
    stdout, stderr = (tmp_path / "out.txt").read_text(), (tmp_path / "err.txt").read_text()
    said = stdout + stderr
    positions = re.findall(r"vcan0 +1A0 +\[8\] +(.. .. .. ..) (..) .. .. ..", stdout)
    assert len(positions) == 5, said
    check(judge, said)
    if judge.machine_held:
        check_positions(positions, stdout)
    assert "running node 32 (20h)" in stdout
    assert "encoder interface: node 16 (10h)" in stdout
    assert "motion: 61 rpm: up to 25.5 cycles per sample" in stdout
    assert "start: all nodes" in stdout
    # A loaded machine may not hold 100 Hz, and then it says so.
    complaints = [line for line in stderr.splitlines() if line.startswith("canfb:")]
    assert [line for line in complaints if not line.startswith("canfb: SYNC: ")] == []
    assert "Traceback" not in stderr


def check_positions(positions: list[tuple[str, str]], stdout: str) -> None:
    """What candump has printed last, and what the master in Python has read."""
    assert len({bytes.fromhex(position) for position, _ in positions}) == 5, "the machine turns"
    assert any(int(status, 16) & 1 for _, status in positions), stdout
    shown = re.search(r"^([0-9.]+) cycles$", stdout, re.M)
    assert shown is not None, stdout
    assert float(shown[1]) > 1000.0
