"""`canfb monitor --frames`: a line for each frame, of a log or of a bus."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import can
import pytest

from canfb.cia301.frame import Frame
from canfb.cli.main import main
from canfb.configuration import Config
from canfb.hosting.trying import NetworkOnBus
from canfb.module.module_config import ModuleConfig
from fake_bus import message
from monitored_network import MonitoredNetwork

PDOS = (0x190, 0x1A0, 0x1B1, 0x2A0, 0x2B1)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "drive.asc"
    with can.Logger(str(path)) as writer:
        for k in range(3):
            for after, can_id, data in (
                (0.0, 0x080, b""),
                (0.001, 0x190, struct.pack("<hh", 100 * k, 1500)),
                (0.002, 0x1A0, struct.pack("<IHH", k, 1, 0)),
            ):
                writer.on_message_received(
                    can.Message(
                        timestamp=1000.0 + 0.01 * k + after,
                        arbitration_id=can_id,
                        data=data,
                        is_extended_id=False,
                    )
                )
    return path


def test_a_log_in_lines(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", "--frames", "0x20", "--log", str(log)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 9
    assert lines[0] == "(0.000000)  080  [0]                           SYNC"
    assert lines[4].endswith("RPDO1 of 32: sine 100 ADC counts, cosine 1500 ADC counts")
    assert lines[8].startswith("(0.022000)  1A0  [8]  02 00 00 00 01 00 00 00  TPDO1 of 32: position value 2")


def test_a_log_for_programs(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", "--frames", "0x20", "--log", str(log), "--json", "--pdo"]) == 0
    figures = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [one["kind"] for one in figures] == ["rpdo", "tpdo"] * 3
    assert figures[-1]["values"]["6004:00"] == 2
    assert figures[-1]["time_s"] == pytest.approx(0.022)


def test_modules_that_nobody_names_are_known_by_what_they_send(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In a log from its first frame on; of other nodes nothing is taken for a PDO of a module."""
    network, path = MonitoredNetwork((0x20, 0x31), known=()), tmp_path / "drive.log"
    network.run(0.2)
    with can.Logger(path) as writer:
        for frame, now in network.frames:
            writer(message(frame.can_id, frame.data, timestamp=1e6 + now))
    assert main(["monitor", "--frames", "--log", str(path), "--json", "--pdo"]) == 0
    figures = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    sent = [frame.can_id for frame, _ in network.frames if frame.can_id in PDOS]
    assert [one["can_id"] for one in figures] == sent
    assert {one["node"] for one in figures if one["kind"] == "tpdo"} == {0x20, 0x31}


def test_seconds_end_a_log(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", "--frames", "--log", str(log), "--seconds", "0.009"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 3


def test_a_configuration_names_modules_and_bus(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "feedback.yaml"
    path.write_text("bus: {interface: virtual, channel: dump}\nmodules: [{node_id: 32}]\n", encoding="utf-8")
    with can.Bus(interface="virtual", channel="dump") as other:
        other.send_periodic(can.Message(arbitration_id=0x190, data=bytes(4), is_extended_id=False), 0.005)
        assert main(["monitor", "--frames", str(path), "--seconds", "0.3", "--listen"]) == 0
    assert "RPDO1 of 32: sine 0 ADC counts" in capsys.readouterr().out


def test_on_a_bus_the_modules_are_asked_for_their_mapping(capsys: pytest.CaptureFixture[str]) -> None:
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
        words = ["-i", "virtual", "-c", demo.words["channel"], "--seconds", "0.3"]
        assert main(["monitor", "--frames", *words]) == 0
    out = capsys.readouterr().out
    assert "TPDO3 of 32: velocity " in out
    assert "RPDO1 of 32: sine " in out
