"""The terminal of a running command goes: it gets SIGHUP, and ends as after Ctrl-C."""

from __future__ import annotations

import os
import pty
import select
import subprocess
import sys
import time
from pathlib import Path

import pytest

LIMIT_S = 60.0
CONFIG = """\
bus: {interface: virtual, channel: hangup}
modules: [{node_id: 32, state_dir: state}]
"""


# Its controlling terminal is the one on its standard input.
OWN_TERMINAL = """\
import fcntl, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
from canfb.cli.main import main
sys.exit(main(sys.argv[1:]))
"""


def started(folder: Path, arguments: list[str]) -> tuple[subprocess.Popen[bytes], int]:
    """A command with a terminal of its own: the process, and the other end of the terminal."""
    ours, theirs = pty.openpty()
    try:
        process = subprocess.Popen(
            [sys.executable, "-c", OWN_TERMINAL, *arguments],
            cwd=folder,
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            start_new_session=True,
        )
    finally:
        os.close(theirs)
    return process, ours


def read_until(terminal: int, words: bytes) -> None:
    said, deadline = b"", time.monotonic() + LIMIT_S
    while words not in said:
        ready, _, _ = select.select([terminal], [], [], max(0.0, deadline - time.monotonic()))
        chunk = os.read(terminal, 4096) if ready else b""
        if not chunk:
            pytest.fail(f"no {words!r} in {said!r}")
        said += chunk


@pytest.mark.parametrize("command", [["run"], ["simulate", "--rate", "100"]], ids=["run", "simulate"])
def test_it_ends_cleanly_and_leaves_no_ready_file(tmp_path: Path, command: list[str]) -> None:
    (tmp_path / "feedback.yaml").write_text(CONFIG)
    arguments = [*command, "feedback.yaml", "--ready-file", "ready"]
    process, terminal = started(tmp_path, arguments)
    try:
        try:
            read_until(terminal, b"end with Ctrl-C")
            deadline = time.monotonic() + LIMIT_S
            while not (tmp_path / "ready").exists():
                assert time.monotonic() < deadline
                time.sleep(0.02)
        finally:
            os.close(terminal)  # what a dropped connection does
        assert process.wait(LIMIT_S) == 0
    finally:
        process.kill()
        process.wait()
    assert not (tmp_path / "ready").exists()
    if command == ["run"]:
        assert any((tmp_path / "state").iterdir()), "the operating time was saved at the end"
