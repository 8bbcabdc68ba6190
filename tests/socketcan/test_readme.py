"""The first session of the README, pasted into a shell."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
NOT_HERE = ("sudo ", ". .venv/")  # the interface is there, and so is the environment


def shell_blocks() -> list[str]:
    return re.findall(r"```sh\n(.*?)```", (ROOT / "README.md").read_text(), flags=re.S)


@pytest.mark.usefixtures("can_utils")
def test_the_first_session_can_be_pasted(tmp_path: Path) -> None:
    (session,) = [block for block in shell_blocks() if "candump" in block]
    lines = [line for line in session.splitlines() if not line.startswith(NOT_HERE)]
    # A loaded test machine may need longer than a person's to have both up.
    script = "set -m\n" + "\n".join([*lines, "wait"]).replace("sleep 4", "sleep 12")
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    done = subprocess.run(
        ["bash", "-c", script],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    positions = re.findall(r"vcan0 +1A0 +\[8\] +.. .. .. .. 01 00 .. ..", done.stdout)
    assert len(positions) == 5, done.stdout + done.stderr
    assert "running node 32 (20h)" in done.stdout
    assert "encoder interface: node 16 (10h)" in done.stdout
    assert "canfb:" not in done.stderr
    assert "Traceback" not in done.stderr
