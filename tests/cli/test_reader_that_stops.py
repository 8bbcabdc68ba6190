"""The reader of a running command does not read (Ctrl-S in a terminal, a pager): the command goes on."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from canfb.cli.printing import printed_as_json, printed_log, printed_without_waiting

LIMIT_S = 60.0
CONFIG = """\
bus: {interface: virtual, channel: reader}
modules: [{node_id: 32}]
"""


@pytest.mark.parametrize("command", [["run"], ["simulate", "--rate", "100"]], ids=["run", "simulate"])
def test_it_goes_on_and_ends(tmp_path: Path, command: list[str]) -> None:
    (tmp_path / "feedback.yaml").write_text(CONFIG)
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, bytes(1 << 16))
    os.set_blocking(writing, True)  # as a command finds it
    arguments = [sys.executable, "-m", "canfb", *command, "feedback.yaml", "--ready-file", "ready"]
    process = subprocess.Popen(arguments, cwd=tmp_path, stdout=writing)
    os.close(writing)
    try:
        deadline = time.monotonic() + LIMIT_S
        while not (tmp_path / "ready").exists():
            assert time.monotonic() < deadline, "it waits for its reader"
            time.sleep(0.02)
        said = b""
        while b"end with Ctrl-C\n" not in said:  # the reader goes on, and gets what was kept for it
            assert time.monotonic() < deadline, said[-200:]
            said += (
                os.read(reading, 1 << 16).lstrip(b"\0") if select.select([reading], [], [], 0.1)[0] else b""
            )
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
        with printed_as_json():
            log.info("SYNC found")
    out, err = capfd.readouterr()
    text, values = out.splitlines()
    assert text == "position valid"
    assert json.loads(values) == {"event": "message", "level": "info", "text": "SYNC found"}
    assert err == "canfb: the bus fails\n"
