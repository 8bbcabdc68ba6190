"""`canfb monitor`: JSON, lines, frames and the page, in a terminal or a browser, of a log and of a bus."""

import gzip
import os
import signal
import socket
import struct
import sys
from pathlib import Path

import can
import pytest

from canfb import Config, ModuleConfig
from canfb.hosting.trying import NetworkOnBus
from canfb.monitoring.snapshot import BusSnapshot
from canfb.monitoring.watching import Watching
from canfb.scope.page_server import LivePage
from commands import Command, yaml_file
from fake_bus import message
from folding import each
from monitored_network import MonitoredNetwork
from processes import python


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """1.2 s of a module that loses its position at the end."""
    network = MonitoredNetwork().run(1.2)
    network.source.lost = True
    network.run(0.05)
    return network.log(tmp_path_factory.mktemp("log") / "drive.log")


def test_json_has_an_object_per_update(log: Path, command: Command) -> None:
    said = command("monitor --json -b 1000000 --log", log)
    updates = said.objects
    assert said.err == ""
    assert [round(one["time_s"], 1) for one in updates] == [0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.2]
    nodes = {node["node_id"]: node for node in updates[-1]["nodes"]}
    assert nodes[32]["module"]["position_state"] == "lost"
    assert nodes[32]["module"]["layout"] == "assumed"
    assert nodes[32]["emergencies"][0]["text"] == "sensor: position not valid"
    assert nodes[16]["module"] is None
    assert 0.2 < updates[-2]["load"]["load"] < 0.6


def test_without_a_terminal_there_are_lines(log: Path, command: Command) -> None:
    first, *_, last = command("monitor 0x20 --speed 1e5 --log", log).lines
    assert first.startswith("1.000 node 32 (20h): OPERATIONAL (by PDO), status valid, ")
    assert "lost, sample missed" in last
    assert "\x1b" not in first + last


def test_on_a_terminal_there_is_a_page_that_leaves_a_line(
    log: Path, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    for name, value in (("TERM", "xterm-256color"), ("COLUMNS", "100"), ("LINES", "30")):
        monkeypatch.setenv(name, value)
    out = command("monitor 32 --speed 1e5 --per-revolution '5 mm' --log", log).out
    page, _, after = out.partition("\x1b[?1049l")
    assert "\x1b[?1049h" in page, "a screen of its own"
    assert "node 32 (20h)" in page
    assert "mm/s" in page
    assert after.count("\n") <= 2
    assert "lost, sample missed" in after


def test_without_rich_one_line_says_what_to_do(
    log: Path, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    monkeypatch.setitem(sys.modules, "rich.live", None)
    assert command("monitor --log", log, code=1).err == (
        "canfb: the live page needs rich: pip install 'canfb[monitor]'; or use --plain or --json\n"
    )
    command("monitor --plain --log", log)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_with_exit_code_0(
    number: signal.Signals, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = Watching.opened

    def interrupted(watching: Watching, bus: can.BusABC) -> None:
        signal.raise_signal(number)
        opened(watching, bus)

    monkeypatch.setattr(Watching, "opened", interrupted)
    assert command("monitor -i virtual -c canfb-monitor --json") == ("", "")


def test_it_only_listens(command: Command) -> None:
    line = "monitor 32 -i virtual -c canfb-listen --seconds 0.3 --plain"
    with can.Bus(interface="virtual", channel="canfb-listen") as bus:
        assert command(line).err == ""
        assert bus.recv(0.0) is None
        assert command(f"{line} --sdo").err == ""
        request = bus.recv(0.0)
        assert request is not None
        assert (request.arbitration_id, request.data[0]) == (0x620, 0x40)


def test_the_configuration_names_modules_and_their_interfaces(
    log: Path, tmp_path: Path, command: Command
) -> None:
    text = "modules: [{node_id: 32, cycles_per_revolution: 5000}, {node_id: 33, encoder_interface: 17}]\n"
    path = yaml_file(tmp_path, text)
    last = command(f"monitor --config {path} --json --log", log).objects[-1]
    modules = {node["node_id"]: node["module"] for node in last["nodes"] if node["module"]}
    assert {one["layout"] for one in modules.values()} == {"configuration"}
    assert modules[32]["tracks_counts"]
    assert not modules[33]["tracks_counts"]


def test_what_cannot_be_opened_is_one_line_and_no_address(command: Command, tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        for options, said in (
            (f"-i virtual -c page --port {port}", "cannot listen at 127.0.0.1"),
            ("-i slcan -c /dev/there-is-none", "cannot open the bus slcan /dev/there-is-none"),
            (f"--log {tmp_path}/none.log", "none.log: cannot be read: No such file"),
        ):
            out, error = command(f"monitor --web {options}", code=1)
            assert said in error
            assert error.count("\n") == 1
            assert out == "" or "--log" in options


def test_a_log_is_shown_without_a_bus(log: Path, command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """Until it is stopped, after the end of the log too."""
    seen: list[BusSnapshot] = []
    show = LivePage.show

    def shown(page: LivePage, snapshot: BusSnapshot) -> None:
        show(page, snapshot)
        seen.append(snapshot)
        if len(seen) == 7:
            os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr(LivePage, "show", shown)
    out, error = command("monitor --web --speed 100 --log", log)
    assert out.startswith("open http://127.0.0.1:")
    assert error == ""
    assert seen[-1].modules[0][1].position_state == "lost"


def test_the_help_loads_no_server() -> None:
    code = (
        "from canfb.cli.commands import build_parser; build_parser('monitor').format_help(); import sys\n"
        "print(sorted({'http.server', 'canfb.scope.page_server', 'canopen'} & set(sys.modules)))"
    )
    assert python("-c", code).stdout == "[]\n"


def test_a_log_in_lines(tmp_path: Path, command: Command) -> None:
    path = tmp_path / "drive.asc"
    with can.Logger(str(path)) as writer:
        for k in range(3):
            sample, position = struct.pack("<hh", 100 * k, 1500), struct.pack("<IHH", k, 1, 0)
            for n, (can_id, data) in enumerate(((0x080, b""), (0x190, sample), (0x1A0, position))):
                writer(message(can_id, data, timestamp=1000.0 + 0.01 * k + 0.001 * n))
    lines = command("monitor --frames 0x20 --log", path).lines
    assert len(lines) == 9
    assert command("monitor --frames 0x20 --seconds 0.009 --log", path).lines == lines[:3]
    assert lines[0] == "(0.000000)  080  [0]                           SYNC"
    assert lines[4].endswith("RPDO1 of 32: sine 100 ADC counts, cosine 1500 ADC counts")
    assert lines[8].startswith("(0.022000)  1A0  [8]  02 00 00 00 01 00 00 00  TPDO1 of 32: position value 2")


@each("words, least", [("--frames", 1000), ("--frames 0x20", 1000), ("--speed 1e5", 2)])
def test_of_a_log_that_is_cut_off_the_rest_is_shown(
    log: Path, words: str, least: int, tmp_path: Path, command: Command
) -> None:
    cut = tmp_path / "cut.log.gz"
    cut.write_bytes(gzip.compress(log.read_bytes())[:-500])
    out, error = command(f"monitor {words} --log", cut, code=1)
    assert out.count("\n") >= least
    assert error.count("nothing can be read after frame") == 1


def test_modules_that_nobody_names_are_known_by_what_they_send(tmp_path: Path, command: Command) -> None:
    """In a log from its first frame on; of other nodes nothing is taken for a PDO of a module."""
    pdos = (0x190, 0x1A0, 0x1B1, 0x2A0, 0x2B1)
    network = MonitoredNetwork((0x20, 0x31), known=()).run(0.2)
    figures = command("monitor --frames --json --pdo --log", network.log(tmp_path / "drive.log")).objects
    sent = [frame.can_id for frame, _ in network.frames if frame.can_id in pdos]
    assert [one["can_id"] for one in figures] == sent
    assert {one["node"] for one in figures if one["kind"] == "tpdo"} == {0x20, 0x31}
    assert all(("6004:00" in one["values"]) == (one["can_id"] in (0x1A0, 0x1B1)) for one in figures)
    assert figures[-1]["time_s"] == pytest.approx(0.2, abs=0.01)


def test_a_configuration_names_modules_and_bus(tmp_path: Path, command: Command) -> None:
    path = yaml_file(tmp_path, "bus: {interface: virtual, channel: dump}\nmodules: [{node_id: 32}]\n")
    with can.Bus(interface="virtual", channel="dump") as other:
        other.send_periodic(message(0x190, bytes(4)), 0.005)
        out = command("monitor --seconds 0.3 --listen --frames", path).out
    assert "RPDO1 of 32: sine 0 ADC counts" in out


def test_on_a_bus_the_modules_are_asked_for_their_mapping(command: Command) -> None:
    """Without a node and a configuration, all that answer; the velocity is not in the mapping of the EDS."""
    download = struct.Struct("<BHBI").pack
    mapped = [
        (0x23, 0x1A02, 1, 0x20110720),
        (0x2F, 0x1A02, 0, 1),
        (0x2F, 0x1802, 2, 254),
        (0x23, 0x1802, 1, 0x3A0),
    ]
    config = Config({"interface": "virtual", "channel": "dump-x"}, [ModuleConfig(node_id=32, autostart=True)])
    with NetworkOnBus(config, 200.0) as demo, can.Bus(**config.bus) as master:
        for one in mapped:
            master.send(message(0x620, download(*one)))
        out = command("monitor --frames -i virtual --seconds 0.3 -c", demo.config.bus["channel"]).out
    assert "TPDO3 of 32: velocity " in out
    assert "RPDO1 of 32: sine " in out
