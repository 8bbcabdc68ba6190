"""Which bus a command opens, what it says without any, and what `canfb node` sends on it."""

import argparse
import re
from collections.abc import Callable
from pathlib import Path

import can
import can.cli
import pytest

from canfb import FeedbackModule, Frame, ModuleConfig, eds_path
from canfb.cia301.codes import NmtState
from canfb.cli.options import BUS_HELP
from commands import Command, yaml_file
from documentation import blocks, page

PAGE = page("wiring")
CHANNEL = "canfb-bus-of"


@pytest.fixture(autouse=True)
def nothing_set(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_BITRATE", "CAN_CONFIG"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def config(tmp_path: Path) -> str:
    text = f"bus: {{interface: virtual, channel: {CHANNEL}}}\nmodules: [{{node_id: 32}}]\n"
    return str(yaml_file(tmp_path, text))


Sent = Callable[..., list[tuple[int, bytes]]]


@pytest.fixture
def sent(command: Command) -> Sent:
    """Runs a command; what it puts on the bus."""

    def frames(line: str, *words: object) -> list[tuple[int, bytes]]:
        with can.Bus(interface="virtual", channel=CHANNEL) as bus:
            command(line, *words)
            found = list(iter(lambda: bus.recv(0.0), None))
        assert not any(one.is_extended_id or one.is_remote_frame for one in found)
        return [(one.arbitration_id, bytes(one.data)) for one in found]

    return frames


ALL = [(0x000, b"\x01\x00")]


def test_without_any_bus_it_says_what_to_give(command: Command) -> None:
    (line,) = command("node start all", code=1).err.splitlines()
    words = ("-i socketcan -c can0", "--config feedback.yaml", "CAN_INTERFACE", "CAN_CHANNEL", "can.conf")
    assert [word for word in words if word not in line] == []


def test_the_environment_names_a_bus(monkeypatch: pytest.MonkeyPatch, sent: Sent) -> None:
    monkeypatch.setenv("CAN_INTERFACE", "virtual")
    monkeypatch.setenv("CAN_CHANNEL", CHANNEL)
    assert sent("node start all") == ALL


def test_so_does_the_file_of_python_can_on_the_page(tmp_path: Path, sent: Sent) -> None:
    (shown,) = blocks(PAGE, "ini")
    assert all(f"`{name}`" in PAGE for name in can.util.CONFIG_FILES)
    text = shown.replace("pcan", "virtual").replace("PCAN_USBBUS1", CHANNEL)
    (tmp_path / "can.conf").write_text(text, encoding="utf-8")
    assert sent("node start all") == ALL


def test_nmt_takes_the_bus_of_a_configuration(config: str, sent: Sent) -> None:
    assert sent("node start 0x10 --config", config) == [(0x000, b"\x01\x10")]


@pytest.mark.parametrize(
    "line", ["sdo read 0x20 2010:03", "sdo write 0x20 2010:03 4", "table show 0x20", "why 0x20"]
)
def test_so_do_the_commands_of_a_node(config: str, line: str, command: Command) -> None:
    """Nobody answers on this bus, so that the bus was opened; and the message says what may be the matter."""
    eds = ["--eds", eds_path("canfb-module")] if line.startswith("sdo") else []
    err = command(f"{line} --timeout 0.02 --config", config, *eds, code=1).err
    assert "no answer; is the node on the bus" in err
    assert "A STOPPED node answers no SDO: canfb node preop 0x20" in err


@pytest.mark.parametrize("name", ["node start", "sdo read", "monitor", "log record", "run"])
def test_a_help_has_three_options_of_the_bus(name: str, command: Command) -> None:
    text = command(f"{name} --help").out
    assert "canalystii" not in text
    assert "--help-bus" in text
    group = text.partition("\nbus:")[2].partition("examples:")[0]
    assert re.findall(r"--[a-z]+", group) == ["--channel", "--interface", "--bitrate"]
    assert "--data-bitrate" in command(f"{name} --help-bus").out


def test_every_option_of_python_can_has_a_text_of_ours() -> None:
    """A version of python-can with another option shows its own text, until it has one here."""
    parser = argparse.ArgumentParser(add_help=False)
    can.cli.add_bus_arguments(parser)
    assert {action.dest for action in parser._actions} == set(BUS_HELP)


def test_the_default_bus_is_remembered_and_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Command, sent: Sent
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "user"))
    assert command("use").lines == ["no default bus"]
    assert "4. `canfb use`;" in PAGE
    said = command("use -i virtual -c", CHANNEL)
    assert said.lines == [f"default bus: virtual {CHANNEL} ({tmp_path}/user/canfb/bus.json)"]
    assert sent("node start all") == ALL
    assert command.said.err == f"canfb: bus: virtual {CHANNEL} (canfb use)\n"
    text = "bus: {interface: virtual, channel: other}\nmodules: [{node_id: 32}]\n"
    other = yaml_file(tmp_path, text, "other.yaml")
    assert sent("node start all --config", other) == [], "the configuration takes precedence"
    assert sent("node start all -c other") == [], "and so do options"
    monkeypatch.setenv("CAN_CHANNEL", "other")
    assert sent("node start all") == [], "and so does the environment"
    monkeypatch.delenv("CAN_CHANNEL")
    log = yaml_file(tmp_path, "(1.0) can0 080#\n", "bus.log")
    for text in ("[1]", "{"):
        (tmp_path / "user/canfb/bus.json").write_text(text)
        assert command("monitor --log", log).err == "", "a log needs no bus"
        command("node start all", code=2)
    command("use --forget")
    command("use -c can0", code=2)
    command("use -i none", code=2)
    monkeypatch.delenv("XDG_CONFIG_HOME")
    monkeypatch.setenv("HOME", "~")  # Path.home raises, as for a user without an entry
    assert command("use").lines == ["no default bus"]
    assert "set XDG_CONFIG_HOME" in command("use -i virtual -c x", code=1).err


@pytest.mark.parametrize(
    ("part", "specifier", "state"),
    [
        ("start", 1, NmtState.OPERATIONAL),
        ("stop", 2, NmtState.STOPPED),
        ("preop", 0x80, NmtState.PRE_OPERATIONAL),
        ("reset --force", 0x81, NmtState.PRE_OPERATIONAL),
        ("reset --force --communication", 0x82, NmtState.PRE_OPERATIONAL),
    ],
)
def test_each_command_reaches_the_state_that_its_help_names(
    part: str, specifier: int, state: NmtState, command: Command, sent: Sent
) -> None:
    """Nodes in the order given, and once each."""
    found = sent(f"node {part} 0x20 16 0x20 -i virtual -c", CHANNEL)
    frames = [one for one in found if not one[0]]
    assert frames == [(0x000, bytes((specifier, node))) for node in (0x20, 16)]
    asked = part.startswith("reset")
    names = ("32 (20h)", "16 (10h)")
    assert command.said.out.startswith(
        "".join(f"node {name}: reset\n" for name in names) if asked else f"{part}: {', '.join(names)}\n"
    )
    module = FeedbackModule(ModuleConfig(node_id=0x20))
    module.start(0.0)
    sent_back = [frame for can_id, data in frames for frame in module.receive(Frame(can_id, data), 1.0)]
    sent_back += module.tick(2.0)
    assert module.state is state
    assert (Frame(0x720, b"\0") in sent_back) is asked, "a reset ends with the boot-up"
