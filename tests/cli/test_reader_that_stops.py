"""The reader of a running command does not read (Ctrl-S, a pager), or its terminal goes (SIGHUP)."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import pty
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from canfb.cli.printing import print_as_json, printed_log, printed_without_waiting

LIMIT_S = 60.0
CONFIG = """\
bus: {interface: virtual, channel: reader}
modules: [{node_id: 32, state_dir: state}]
"""


def wait_for(ready_file: Path) -> None:
    deadline = time.monotonic() + LIMIT_S
    while not ready_file.exists():
        assert time.monotonic() < deadline, "it waits for its reader"
        time.sleep(0.02)


def read_until(descriptor: int, words: bytes) -> None:
    said = b""
    while words not in said:
        assert select.select([descriptor], [], [], LIMIT_S)[0], f"no {words!r} in {said!r}"
        said += os.read(descriptor, 1 << 16).lstrip(b"\0")


def test_it_goes_on_and_ends(tmp_path: Path) -> None:
    (tmp_path / "feedback.yaml").write_text(CONFIG)
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, bytes(1 << 16))
    os.set_blocking(writing, True)  # as a command finds it
    arguments = [sys.executable, "-m", "canfb", "run", "feedback.yaml", "--ready-file", "ready"]
    process = subprocess.Popen(arguments, cwd=tmp_path, stdout=writing)
    os.close(writing)
    try:
        wait_for(tmp_path / "ready")
        read_until(reading, b"end with Ctrl-C\n")  # the reader goes on, and gets what was kept for it
        process.send_signal(signal.SIGTERM)
        assert process.wait(LIMIT_S) == 0
    finally:
        process.kill()
        process.wait()
        os.close(reading)


def test_lines_go_where_they_belong(capfd: pytest.CaptureFixture[str]) -> None:
    log = logging.getLogger("canfb.test")
    with printed_log(), printed_without_waiting():
        log.info("position valid")
        log.warning("the bus fails")
        print_as_json()
        log.info("SYNC found")
    out, err = capfd.readouterr()
    text, values = out.splitlines()
    assert text == "position valid"
    assert json.loads(values) == {"event": "message", "level": "info", "text": "SYNC found"}
    assert err == "canfb: the bus fails\n"


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


@pytest.mark.parametrize("command", [["run"], ["simulate", "--rate", "100"]], ids=["run", "simulate"])
def test_without_its_terminal_it_ends_and_leaves_no_ready_file(tmp_path: Path, command: list[str]) -> None:
    (tmp_path / "feedback.yaml").write_text(CONFIG)
    arguments = [*command, "feedback.yaml", "--ready-file", "ready"]
    process, terminal = started(tmp_path, arguments)
    try:
        try:
            read_until(terminal, b"end with Ctrl-C")
            wait_for(tmp_path / "ready")
        finally:
            os.close(terminal)  # what a dropped connection does
        assert process.wait(LIMIT_S) == 0
    finally:
        process.kill()
        process.wait()
    assert not (tmp_path / "ready").exists()
    if command == ["run"]:
        assert any((tmp_path / "state").iterdir()), "the operating time was saved at the end"
