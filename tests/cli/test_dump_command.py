"""`canfb monitor --frames`: a line for each frame, of a log or of a bus."""

from __future__ import annotations

import struct
from pathlib import Path

import can
import pytest

from canfb.cia301.frame import Frame
from canfb.configuration import Config
from canfb.hosting.trying import NetworkOnBus
from canfb.module.module_config import ModuleConfig
from commands import Command
from fake_bus import message
from monitored_network import MonitoredNetwork

PDOS = (0x190, 0x1A0, 0x1B1, 0x2A0, 0x2B1)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "drive.asc"
    with can.Logger(str(path)) as writer:
        for k in range(3):
            sample, position = struct.pack("<hh", 100 * k, 1500), struct.pack("<IHH", k, 1, 0)
            for n, (can_id, data) in enumerate(((0x080, b""), (0x190, sample), (0x1A0, position))):
                writer(message(can_id, data, timestamp=1000.0 + 0.01 * k + 0.001 * n))
    return path


def test_a_log_in_lines(log: Path, command: Command) -> None:
    lines = command("monitor --frames 0x20 --log", log).lines
    assert len(lines) == 9
    assert lines[0] == "(0.000000)  080  [0]                           SYNC"
    assert lines[4].endswith("RPDO1 of 32: sine 100 ADC counts, cosine 1500 ADC counts")
    assert lines[8].startswith("(0.022000)  1A0  [8]  02 00 00 00 01 00 00 00  TPDO1 of 32: position value 2")


def test_modules_that_nobody_names_are_known_by_what_they_send(tmp_path: Path, command: Command) -> None:
    """In a log from its first frame on; of other nodes nothing is taken for a PDO of a module."""
    network = MonitoredNetwork((0x20, 0x31), known=())
    network.run(0.2)
    figures = command("monitor --frames --json --pdo --log", network.log(tmp_path / "drive.log")).objects
    sent = [frame.can_id for frame, _ in network.frames if frame.can_id in PDOS]
    assert [one["can_id"] for one in figures] == sent
    assert {one["node"] for one in figures if one["kind"] == "tpdo"} == {0x20, 0x31}
    assert all(("6004:00" in one["values"]) == (one["can_id"] in (0x1A0, 0x1B1)) for one in figures)
    assert figures[-1]["time_s"] == pytest.approx(0.2, abs=0.01)


def test_seconds_end_a_log(log: Path, command: Command) -> None:
    assert len(command("monitor --frames --seconds 0.009 --log", log).lines) == 3


def test_a_configuration_names_modules_and_bus(tmp_path: Path, command: Command) -> None:
    path = tmp_path / "feedback.yaml"
    path.write_text("bus: {interface: virtual, channel: dump}\nmodules: [{node_id: 32}]\n", encoding="utf-8")
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
    first = [Frame(0x620, download(*one)) for one in mapped]
    with NetworkOnBus(config, 200.0, first=first) as demo:
        out = command("monitor --frames -i virtual --seconds 0.3 -c", demo.words["channel"]).out
    assert "TPDO3 of 32: velocity " in out
    assert "RPDO1 of 32: sine " in out
