"""``canfb monitor --web``: wrong use is one line, before anything is opened; a log is shown without a bus."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import can
import pytest

from canfb.cli.main import main
from canfb.monitoring.snapshot import BusSnapshot
from canfb.scope.live_page import LivePage
from monitored_network import MonitoredNetwork


def test_what_cannot_be_opened_is_one_line_and_no_address(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        for options, said in (
            (["-i", "virtual", "-c", "page", "--port", port], "cannot listen at 127.0.0.1"),
            (["-i", "slcan", "-c", "/dev/there-is-none"], "cannot open the bus slcan /dev/there-is-none"),
            (["--log", str(tmp_path / "none.log")], "none.log: cannot be read: No such file"),
        ):
            assert main(["monitor", "--web", *options]) == 1
            out, error = capsys.readouterr()
            assert said in error
            assert error.count("\n") == 1
            assert out == "" or "--log" in options


def test_a_log_is_shown_without_a_bus(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Until it is stopped, after the end of the log too."""
    network, path = MonitoredNetwork(), tmp_path / "drive.log"
    network.run(1.0)
    with can.Logger(path) as writer:
        for frame, now in network.frames:
            writer(can.Message(1e6 + now, arbitration_id=frame.can_id, data=frame.data, is_extended_id=False))
    seen: list[BusSnapshot] = []
    show = LivePage.show

    def shown(page: LivePage, snapshot: BusSnapshot) -> None:
        show(page, snapshot)
        seen.append(snapshot)
        if len(seen) == 5:
            os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr(LivePage, "show", shown)
    assert main(["monitor", "--web", "--log", str(path), "--speed", "100"]) == 0
    out, error = capsys.readouterr()
    assert out.startswith("open http://127.0.0.1:")
    assert error == ""
    assert seen[-1].modules[0][1].position_state == "valid"


def test_the_help_loads_no_server() -> None:
    code = (
        "from canfb.cli.main import build_parser; build_parser('monitor').format_help(); import sys\n"
        "print(sorted({'http.server', 'canfb.scope.live_page', 'canopen'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
