"""``canfb scope``: wrong use is one line, before anything is opened."""

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
from monitored_network import MonitoredNetwork


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--port 70000", "must be 0 to 65535"),
        ("--speed 2", "goes with --log"),
        ("--log x.log --write", "answers no SDO"),
        ("--demo 32", "module of its own"),
        ("-i virtual -c scope-test --write", "name the nodes"),
        ("-i nonsense", "nonsense"),
        ("--port web", "invalid int value"),
        ("--sdo -i virtual -c scope-test", "name the nodes"),
        ("200", "not a node-ID"),
    ],
)
def test_wrong_use(options: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scope", *options.split()]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_a_missing_library_is_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.startswith(("bokeh", "canfb.scope.scope_server"))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "bokeh", None)
    monkeypatch.delitem(sys.modules, "canfb.scope.scope_page", raising=False)
    assert main(["scope", "--demo"]) == 1
    assert "pip install 'canfb[scope]'" in capsys.readouterr().err


def test_a_port_that_is_taken_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert main(["scope", "--demo", "--port", str(taken.getsockname()[1])]) == 1
    error = capsys.readouterr().err
    assert "cannot listen at 127.0.0.1" in error
    assert error.count("\n") == 1


def test_a_bus_that_cannot_be_opened_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scope", "-i", "slcan", "-c", "/dev/there-is-none"]) == 1
    out, error = capsys.readouterr()
    assert "cannot open the bus slcan /dev/there-is-none" in error
    assert error.count("\n") == 1
    assert out == ""  # no address of a page that will not be there


def test_a_log_that_cannot_be_read_is_one_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["scope", "--log", str(tmp_path / "none.log")]) == 1
    error = capsys.readouterr().err
    assert "none.log: No such file" in error
    assert error.count("\n") == 1


def test_a_log_is_shown_without_a_bus(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Until it is stopped, after the end of the log too; the page has what the log had."""
    from canfb.cli import scope_parts

    network, path = MonitoredNetwork(), tmp_path / "drive.log"
    network.run(1.0)
    with can.Logger(path) as writer:
        for frame, now in network.frames:
            writer(can.Message(1e6 + now, arbitration_id=frame.can_id, data=frame.data, is_extended_id=False))
    seen: list[BusSnapshot] = []

    class Traces(scope_parts.BusTraces):
        def take(self, snapshot: BusSnapshot) -> None:
            super().take(snapshot)
            late = snapshot.time_s > 0.9
            if late and not any(one.time_s > 0.9 for one in seen):  # once: later, nobody takes it
                os.kill(os.getpid(), signal.SIGTERM)
            seen.append(snapshot)

    monkeypatch.setattr(scope_parts, "BusTraces", Traces)
    assert main(["scope", "--log", str(path), "--speed", "100"]) == 0
    out, error = capsys.readouterr()
    assert out.startswith("open http://127.0.0.1:")
    assert error == ""
    assert dict(seen[-1].modules[0][1].seen)["residual"] == 0
    assert seen[-1].modules[0][1].position_state == "valid"


def test_the_help_loads_no_library_of_the_page() -> None:
    code = (
        "from canfb.cli.main import build_parser; build_parser('scope').format_help(); import sys\n"
        "print(sorted({'bokeh', 'tornado', 'jinja2'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
