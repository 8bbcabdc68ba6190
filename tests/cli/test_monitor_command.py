"""`canfb monitor`: JSON, lines and the page, in a terminal or a browser, from a log and from a bus."""

from __future__ import annotations

import json
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
from canfb.monitoring.watching import Watching
from canfb.scope.live_page import LivePage
from monitored_network import MonitoredNetwork


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """1.2 s of a module that loses its position at the end."""
    network = MonitoredNetwork()
    network.run(1.2)
    network.source.lost = True
    network.run(0.05)
    path = tmp_path_factory.mktemp("log") / "drive.log"
    with can.Logger(path) as writer:
        for frame, now in network.frames:
            writer(can.Message(1e6 + now, arbitration_id=frame.can_id, data=frame.data, is_extended_id=False))
    return path


def test_json_has_an_object_per_update(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", "--log", str(log), "--json", "-b", "1000000"]) == 0
    out, err = capsys.readouterr()
    updates = [json.loads(line) for line in out.splitlines()]
    assert err == ""
    assert [round(one["time_s"], 1) for one in updates] == [0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.2]
    nodes = {node["node_id"]: node for node in updates[-1]["nodes"]}
    assert nodes[32]["module"]["position_state"] == "lost"
    assert nodes[32]["module"]["layout"] == "assumed"
    assert nodes[32]["emergencies"][0]["text"] == "sensor: position not valid"
    assert nodes[16]["module"] is None
    assert 0.2 < updates[-2]["load"]["load"] < 0.6


def test_without_a_terminal_there_are_lines(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", "0x20", "--log", str(log), "--speed", "1e5"]) == 0
    first, *_, last = capsys.readouterr().out.splitlines()
    assert first.startswith("1.000 node 32 (20h): OPERATIONAL (by PDO), status valid, ")
    assert "lost, sample missed" in last
    assert "\x1b" not in first + last


def test_on_a_terminal_there_is_a_page_that_leaves_a_line(
    log: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("LINES", "30")
    assert main(["monitor", "32", "--log", str(log), "--speed", "1e5", "--per-revolution", "5 mm"]) == 0
    out = capsys.readouterr().out
    page, _, after = out.partition("\x1b[?1049l")
    assert "\x1b[?1049h" in page, "a screen of its own"
    assert "node 32 (20h)" in page
    assert "mm/s" in page
    assert after.count("\n") <= 2
    assert "lost, sample missed" in after


def test_without_rich_one_line_says_what_to_do(
    log: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    monkeypatch.setitem(sys.modules, "rich.live", None)
    assert main(["monitor", "--log", str(log)]) == 1
    assert capsys.readouterr().err == (
        "canfb: the live page needs rich: pip install 'canfb[monitor]'; or use --plain or --json\n"
    )
    assert main(["monitor", "--log", str(log), "--plain"]) == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_with_exit_code_0(
    number: signal.Signals, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = Watching.opened

    def interrupted(watching: Watching, bus: can.BusABC) -> None:
        signal.raise_signal(number)
        opened(watching, bus)

    monkeypatch.setattr(Watching, "opened", interrupted)
    assert main(["monitor", "-i", "virtual", "-c", "canfb-monitor", "--json"]) == 0
    assert capsys.readouterr() == ("", "")


def test_it_only_listens(capsys: pytest.CaptureFixture[str]) -> None:
    with can.Bus(interface="virtual", channel="canfb-listen") as bus:
        words = ["-i", "virtual", "-c", "canfb-listen", "--seconds", "0.3", "--plain"]
        assert main(["monitor", "32", *words]) == 0
        assert bus.recv(0.0) is None
        assert main(["monitor", "32", *words, "--sdo"]) == 0
        request = bus.recv(0.0)
        assert request is not None
        assert (request.arbitration_id, request.data[0]) == (0x620, 0x40)
    assert capsys.readouterr().err == ""


def test_the_configuration_names_modules_and_their_interfaces(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "two.yaml"
    path.write_text(
        "modules: [{node_id: 32, cycles_per_revolution: 5000}, {node_id: 33, encoder_interface: 17}]\n"
    )
    assert main(["monitor", "--config", str(path), "--log", str(log), "--json"]) == 0
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    modules = {node["node_id"]: node["module"] for node in last["nodes"] if node["module"]}
    assert {one["layout"] for one in modules.values()} == {"configuration"}
    assert modules[32]["tracks_counts"]
    assert not modules[33]["tracks_counts"]


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
