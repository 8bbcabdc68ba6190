"""The first session of docs/vcan.md, the master of docs/first-hour.md, docs/drive-network as it stands."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import can
import pytest
from network import wait_for_boot_up
from pace import Pace

from documentation import blocks, page
from judged_session import check, new_judge
from processes import Started


@pytest.mark.usefixtures("can_utils")
def test_the_first_session_can_be_pasted(can_bus: can.BusABC, tmp_path: Path) -> None:
    (session,) = [block for block in blocks(page("vcan"), "sh") if "candump" in block]
    patient = "import canopen\ncanopen.sdo.SdoClient.RESPONSE_TIMEOUT = 30.0\n"
    (master,) = [block for block in blocks(page("first-hour"), "python") if "import canopen" in block]
    (tmp_path / "master.py").write_text(patient + master)
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
        assert len({bytes.fromhex(position) for position, _ in positions}) == 5, "the machine turns"
        assert any(int(status, 16) & 1 for _, status in positions), stdout
        shown = re.search(r"^([0-9.]+) cycles$", stdout, re.M)
        assert shown is not None, stdout
        assert float(shown[1]) > 1000.0, "what the master in Python has read"
    assert "running node 32 (20h)" in stdout
    assert "encoder interface: node 16 (10h)" in stdout
    assert "motion: 61 rpm: up to 25.5 cycles per sample" in stdout
    assert "start: all nodes" in stdout
    # A loaded machine may not hold 100 Hz, and then it says so.
    complaints = [line for line in stderr.splitlines() if line.startswith("canfb:")]
    assert [line for line in complaints if not line.startswith("canfb: SYNC: ")] == []
    assert "Traceback" not in stderr


FOLDER = Path(__file__).parents[2] / "docs" / "drive-network"


def figure(lines: list[str], what: str, move: int) -> float:
    """A number of the report of the master, after these words, of the n-th move."""
    return float(re.findall(rf"{what} (-?[0-9.]+)", "\n".join(lines))[move])


def test_two_moves_and_an_alarm_between_them(
    process: Started, command: Started, can_bus: can.BusABC, pace: Pace
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
