"""docs/drive-network/README.md: output, keys and figures are those of the program; and without SocketCAN."""

import ast
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import can
import network_file
import pytest
import yaml
from story_bench import FOLDER, DriveNetwork, assert_all_quiet

import canfb
from canfb.configuration import load_config
from documentation import blocks
from processes import Started

PAGE = (FOLDER / "README.md").read_text(encoding="utf-8")
NETWORK = network_file.load(FOLDER / "network.yaml")


def without_numbers(text: str) -> list[str]:
    return [re.sub(r"(?<![0-9A-Za-z])-?[0-9]+(\.[0-9]+)?\b", "#", line) for line in text.splitlines()]


def test_the_output(capsys: pytest.CaptureFixture[str]) -> None:
    (shown,) = blocks(PAGE, "text")
    network = DriveNetwork()
    assert network.run("--provoke-alarm") == 0
    said = capsys.readouterr().out
    assert without_numbers(shown) == without_numbers(said)
    written = r"configured: (\d+) object"
    assert re.findall(written, shown) == re.findall(written, said)
    for what in ("rms", "peak", "drive", "module"):
        figures = [re.findall(rf"{what} (-?[0-9.]+)", text) for text in (shown, said)]
        assert [float(x) for x in figures[0]] == pytest.approx([float(x) for x in figures[1]], abs=2e-4)
    (unseen,), (running,) = (
        re.findall(rf"{what} (\d+) SYNC", said) for what in ("position not valid", "left OPERATION ENABLED")
    )
    assert int(unseen) <= 2
    assert int(running) <= 3
    assert_all_quiet(network)


def test_every_key_of_the_file_is_explained() -> None:
    source = (FOLDER / "network_file.py").read_text(encoding="utf-8")
    keys: set[str] = set()
    for call in ast.walk(ast.parse(source)):
        if isinstance(call, ast.Call) and ast.unparse(call.func).endswith(".mapping"):
            words = [node.value for node in ast.walk(call) if isinstance(node, ast.Constant)]
            keys |= {word for text in words if isinstance(text, str) for word in text.split()}
    keys = (keys | set(network_file.IDENTITY)) - {" "}
    assert {"sync_period_us", "inhibit_100us", "watches", "serial_number"} <= keys
    table = PAGE.partition("## The network file")[2].partition("\n## ")[0]
    assert [key for key in sorted(keys) if f"`{key}`" not in table] == []


def test_the_figures_on_acceleration() -> None:
    drive, module = NETWORK.nodes["drive"], NETWORK.nodes["module"]
    config = load_config(FOLDER / "feedback.yaml")
    motor = config.simulation.drive
    assert motor is not None
    torque = motor.rated_torque_nm * int.from_bytes(drive.parameters[0x6072, 0], "little") / 1000
    most = (torque + motor.coulomb_friction_nm) / motor.inertia_kg_m2
    cycles = config.modules[0].cycles_per_revolution
    limit = canfb.max_acceleration(cycles, 1e6 / NETWORK.sync_period_us, 1 / 3)
    assert most == pytest.approx(16.5)
    assert most < 18.0 < limit == pytest.approx(20.5, abs=0.1)
    assert module.parameters[0x2001, 1] == cycles.to_bytes(4, "little")


def test_the_files_agree() -> None:
    drive, module = NETWORK.nodes["drive"].parameters, NETWORK.nodes["module"].parameters
    assert module[0x6001, 0] == drive[0x60E6, 1] == drive[0x608F, 1]
    assert module[0x6002, 0] == drive[0x2110, 5]
    assert drive[0x60C2, 1][0] * 1000 == NETWORK.sync_period_us
    config = load_config(FOLDER / "feedback.yaml")
    assert config.bus == NETWORK.bus
    assert config.simulation.drive is not None
    assert config.modules[0].node_id == NETWORK.nodes["module"].node_id
    assert config.modules[0].encoder_interface == NETWORK.nodes["interface"].node_id
    assert config.simulation.drive.node_id == NETWORK.nodes["drive"].node_id


def test_two_moves_and_an_alarm_between_them(
    multicast_bus: can.BusABC, multicast_words: dict[str, Any], tmp_path: Path, started: Started
) -> None:
    (line,) = re.findall(r"`(canfb simulate feedback.yaml --pace sync)` in place", PAGE)
    assert "bus: {interface: udp_multicast, channel: 239.74.163.2}` into both YAML files" in PAGE
    for name in ("feedback.yaml", "network.yaml"):
        text = (FOLDER / name).read_text(encoding="utf-8")
        bus = f"bus: {yaml.safe_dump(multicast_words, default_flow_style=True).strip()}"
        text, count = re.subn(r"^bus: .*$", bus, text, count=1, flags=re.M)
        assert count == 1
        (tmp_path / name).write_text(text.replace("../../eds", str(FOLDER.parents[1] / "eds")))
    shutil.copytree(
        FOLDER, tmp_path / "programs", ignore=shutil.ignore_patterns("*.yaml", "*.md", "__pycache__")
    )
    config = str(tmp_path / "feedback.yaml")
    nodes = []
    for words in (["run", config], line.replace("feedback.yaml", config).split()[1:]):
        nodes.append(started(sys.executable, "-m", "canfb", *words))
        nodes[-1].wait_for("end with Ctrl-C")
    master = (str(tmp_path / "programs" / "master.py"), str(tmp_path / "network.yaml"), "--provoke-alarm")
    story = started(sys.executable, *master)
    assert story.wait() == 0, "\n".join(map(str, [*nodes, story]))
    said = "\n".join(story.lines)
    positions = re.findall(r"position          drive (-?[0-9.]+), module (-?[0-9.]+)", said)
    for revolutions, pair in zip((1.0, -1.0), positions, strict=True):
        assert [float(one) for one in pair] == pytest.approx([revolutions, revolutions], abs=1e-3)
    assert said.index("is in FAULT") < said.index("recovered:")
