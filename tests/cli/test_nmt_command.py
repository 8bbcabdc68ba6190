"""`canfb nmt`: the bytes on the bus, and that real nodes obey."""

from __future__ import annotations

from pathlib import Path

import can
import pytest

from canfb.cia301.frame import Frame
from canfb.cia301.nmt import NmtState
from canfb.cli.main import main
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig

CHANNEL = "canfb-nmt"
BUS = ("-i", "virtual", "-c", CHANNEL)


def sent(*arguments: str) -> list[tuple[int, bytes]]:
    """What the command puts on the bus."""
    with can.Bus(interface="virtual", channel=CHANNEL) as bus:
        assert main(["nmt", *arguments]) == 0
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
        ("reset", 0x81, NmtState.PRE_OPERATIONAL),
        ("reset-comm", 0x82, NmtState.PRE_OPERATIONAL),
    ],
)
def test_each_command_reaches_the_state_that_its_help_names(
    command: str, specifier: int, state: NmtState, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = sent(command, "0x20", *BUS)
    assert frames == [(0x000, bytes((specifier, 0x20)))]
    assert capsys.readouterr().out == f"{command}: 32 (20h)\n"
    module = FeedbackModule(ModuleConfig(node_id=0x20))
    module.start(0.0)
    said = [frame for can_id, data in frames for frame in module.receive(Frame(can_id, data), 1.0)]
    said += module.tick(2.0)
    assert module.node.state is state
    assert (Frame(0x720, b"\0") in said) is command.startswith("reset"), "a reset ends with the boot-up"


def test_all_nodes_are_one_frame(capsys: pytest.CaptureFixture[str]) -> None:
    assert sent("start", "all", *BUS) == [(0x000, b"\x01\x00")]
    assert sent("start", "16", "all", *BUS) == [(0x000, b"\x01\x00")]
    assert capsys.readouterr().out == "start: all nodes\n" * 2


def test_several_nodes_come_in_the_order_given_and_once_each(capsys: pytest.CaptureFixture[str]) -> None:
    assert sent("stop", "32", "0x10", "32", *BUS) == [(0x000, b"\x02\x20"), (0x000, b"\x02\x10")]
    assert capsys.readouterr().out == "stop: 32 (20h), 16 (10h)\n"


def test_the_bus_of_a_configuration(tmp_path: Path) -> None:
    config = tmp_path / "feedback.yaml"
    config.write_text(f"bus: {{interface: virtual, channel: {CHANNEL}}}\nmodules: [{{node_id: 32}}]\n")
    assert sent("start", "all", "--config", str(config)) == [(0x000, b"\x01\x00")]


@pytest.mark.parametrize("node", ["0", "128", "-1", "x", "0x80", "ALL", "1.5"])
def test_what_is_no_node_is_refused_in_one_line(node: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["nmt", "reset", "--", node]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{node!r} is not a node-ID (1 to 127, or 0x01 to 0x7F), nor 'all'" in line


@pytest.mark.parametrize("arguments", [["nmt"], ["nmt", "start"], ["nmt", "begin", "all"]])
def test_nothing_is_meant_that_is_not_said(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """No node is not all of them."""
    assert main(arguments) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_bus_that_is_not_there_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["nmt", "start", "all", "-i", "socketcan", "-c", "vcan77"]) == 1
    assert capsys.readouterr().err.startswith("canfb: cannot open the bus socketcan vcan77: ")
