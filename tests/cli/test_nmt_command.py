"""`canfb node`: the bytes on the bus, and that real nodes obey."""

from __future__ import annotations

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
    frames = [one for one in sent(*command.split(), "0x20", "16", *BUS) if not one[0]]
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
    assert sent("stop", "32", "0x10", "32", *BUS) == [(0x000, b"\x02\x20"), (0x000, b"\x02\x10")]
    assert capsys.readouterr().out == "stop: 32 (20h), 16 (10h)\n"
