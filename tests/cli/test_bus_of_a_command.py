"""Which bus a command opens, what it says without any, and what `canfb node` sends on it."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import can
import can.cli
import pytest

from canfb.cia301.frame import Frame
from canfb.cia301.nmt import NmtState
from canfb.cli.main import main
from canfb.cli.options import BUS_HELP
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig

PAGE = (Path(__file__).parents[2] / "docs" / "wiring.md").read_text(encoding="utf-8")
CHANNEL = "canfb-bus-of"
VARIABLES = ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_BITRATE", "CAN_CONFIG")


@pytest.fixture(autouse=True)
def nothing_set(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def config(tmp_path: Path) -> str:
    path = tmp_path / "feedback.yaml"
    path.write_text(f"bus: {{interface: virtual, channel: {CHANNEL}}}\nmodules: [{{node_id: 32}}]\n")
    return str(path)


def heard(*arguments: str) -> list[bytes]:
    with can.Bus(interface="virtual", channel=CHANNEL) as bus:
        assert main([*arguments]) == 0
        found = []
        while (message := bus.recv(0.0)) is not None:
            found.append(bytes(message.data))
        return found


def test_without_any_bus_it_says_what_to_give(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["node", "start", "all"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    for word in (
        "-i socketcan -c can0",
        "--config feedback.yaml",
        "CAN_INTERFACE",
        "CAN_CHANNEL",
        "can.conf",
    ):
        assert word in line


def test_the_environment_names_a_bus(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAN_INTERFACE", "virtual")
    monkeypatch.setenv("CAN_CHANNEL", CHANNEL)
    assert heard("node", "start", "all") == [b"\x01\x00"]


def test_so_does_the_file_of_python_can_on_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (shown,) = re.findall(r"```ini\n(.*?)```", PAGE, re.S)
    assert all(f"`{name}`" in PAGE for name in can.util.CONFIG_FILES)
    text = shown.replace("pcan", "virtual").replace("PCAN_USBBUS1", CHANNEL)
    (tmp_path / "can.conf").write_text(text, encoding="utf-8")
    assert heard("node", "start", "all") == [b"\x01\x00"]


def test_nmt_takes_the_bus_of_a_configuration(config: str) -> None:
    assert heard("node", "start", "0x10", "--config", config) == [b"\x01\x10"]


@pytest.mark.parametrize(
    "arguments",
    [
        ["sdo", "read", "0x20", "2010:03"],
        ["sdo", "write", "0x20", "2010:03", "4"],
        ["table", "show", "0x20"],
        ["why", "0x20"],
    ],
)
def test_so_do_the_commands_of_a_node(
    config: str, arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Nobody answers on this bus, so that the bus was opened; and the message says what may be the matter."""
    options = ["--timeout", "0.02"]
    if arguments[0] == "sdo":
        options += ["--eds", str(Path(__file__).parents[2] / "eds" / "canfb-module.eds")]
    assert main([*arguments, "--config", config, *options]) == 1
    err = capsys.readouterr().err
    assert "no answer; is the node on the bus" in err
    assert "A STOPPED node answers no SDO: canfb node preop 0x20" in err


@pytest.mark.parametrize("command", ["node start", "sdo read", "monitor", "log record", "run"])
def test_a_help_has_three_options_of_the_bus(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*command.split(), "--help"]) == 0
    text = capsys.readouterr().out
    assert "canalystii" not in text
    assert "--help-bus" in text
    group = text.partition("\nbus:")[2].partition("examples:")[0]
    assert re.findall(r"--[a-z]+", group) == ["--channel", "--interface", "--bitrate"]
    assert main([*command.split(), "--help-bus"]) == 0
    assert "--data-bitrate" in capsys.readouterr().out


def test_every_option_of_python_can_has_a_text_of_ours() -> None:
    """A version of python-can with another option shows its own text, until it has one here."""
    parser = argparse.ArgumentParser(add_help=False)
    can.cli.add_bus_arguments(parser)
    assert {action.dest for action in parser._actions} == set(BUS_HELP)


def test_the_default_bus_is_remembered_and_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "user"))
    assert main(["use"]) == 0
    assert main(["use", "-i", "virtual", "-c", CHANNEL]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "no default bus",
        f"default bus: virtual {CHANNEL} ({tmp_path}/user/canfb/bus.json)",
    ]
    assert heard("node", "start", "all") == [b"\x01\x00"]
    assert capsys.readouterr().err == f"canfb: bus: virtual {CHANNEL} (canfb use)\n"
    other = tmp_path / "other.yaml"
    other.write_text("bus: {interface: virtual, channel: other}\nmodules: [{node_id: 32}]\n")
    assert heard("node", "start", "all", "--config", str(other)) == [], "a configuration goes before it"
    assert heard("node", "start", "all", "-c", "other") == [], "and so do options"
    monkeypatch.setenv("CAN_CHANNEL", "other")
    assert heard("node", "start", "all") == [], "and so does the environment"
    monkeypatch.delenv("CAN_CHANNEL")
    for text in ("[1]", "{"):
        (tmp_path / "user/canfb/bus.json").write_text(text)
        assert main(["node", "start", "all"]) == 2
    assert main(["use", "--forget"]) == 0
    assert main(["use", "-c", "can0"]) == 2
    assert main(["use", "-i", "none"]) == 2


NODE_CHANNEL = "canfb-nmt"
NODE_BUS = ("-i", "virtual", "-c", NODE_CHANNEL)


def sent(*arguments: str) -> list[tuple[int, bytes]]:
    """What the command puts on the bus."""
    with can.Bus(interface="virtual", channel=NODE_CHANNEL) as bus:
        assert main(["node", *arguments]) == 0
        heard = []
        while (message := bus.recv(0.0)) is not None:
            assert not message.is_extended_id
            assert not message.is_remote_frame
            heard.append((message.arbitration_id, bytes(message.data)))
    return heard


@pytest.mark.parametrize(
    ("command", "specifier", "state"),
    [
        ("start", 1, NmtState.OPERATIONAL),
        ("stop", 2, NmtState.STOPPED),
        ("preop", 0x80, NmtState.PRE_OPERATIONAL),
        ("reset --force", 0x81, NmtState.PRE_OPERATIONAL),
        ("reset --force --communication", 0x82, NmtState.PRE_OPERATIONAL),
    ],
)
def test_each_command_reaches_the_state_that_its_help_names(
    command: str, specifier: int, state: NmtState, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = [one for one in sent(*command.split(), "0x20", "16", *NODE_BUS) if not one[0]]
    assert frames == [(0x000, bytes((specifier, node))) for node in (0x20, 16)]
    said = capsys.readouterr().out
    assert said.startswith(
        (f"{command}: 32 (20h), 16 (10h)\n", "node 32 (20h): reset\nnode 16 (10h): reset\n")
    )
    module = FeedbackModule(ModuleConfig(node_id=0x20))
    module.start(0.0)
    sent_back = [frame for can_id, data in frames for frame in module.receive(Frame(can_id, data), 1.0)]
    sent_back += module.tick(2.0)
    assert module.node.state is state
    assert (Frame(0x720, b"\0") in sent_back) is command.startswith("reset"), "a reset ends with the boot-up"


def test_several_nodes_come_in_the_order_given_and_once_each(capsys: pytest.CaptureFixture[str]) -> None:
    assert sent("stop", "32", "0x10", "32", *NODE_BUS) == [(0x000, b"\x02\x20"), (0x000, b"\x02\x10")]
    assert capsys.readouterr().out == "stop: 32 (20h), 16 (10h)\n"
