"""`canfb node list`: who is there, in which state, with which identity; and nothing that harms anybody."""

from __future__ import annotations

import contextlib

import can
import pytest

from canfb.cia301.frame import Frame
from canfb.diagnosis.nodes_and_frames import FoundNode, scan
from commands import Command
from commissioning_kit import INTERFACE_ID, MODULE_ID, Bench, EmbeddedMaster, heard


def scanned(bench: Bench, seconds: float = 0.3) -> dict[int, FoundNode]:
    return {one.node_id: one for one in scan(EmbeddedMaster(bench.bus), seconds)}


def test_all_nodes_with_state_and_identity() -> None:
    bench = Bench(sync=False)
    bench.module.receive(Frame(0x000, bytes((0x80, MODULE_ID))), 0.0)
    found = scanned(bench)
    assert sorted(found) == [INTERFACE_ID, MODULE_ID]
    module, interface = found[MODULE_ID], found[INTERFACE_ID]
    assert (module.state, interface.state) == ("PRE-OPERATIONAL", "OPERATIONAL")
    assert module.name == "canfb drive feedback module"
    assert (module.device_type, module.product_code) == (0x00040196, 1)
    assert interface.product_code == 2
    assert module.line().startswith(
        " 32 (20h)  PRE-OPERATIONAL  canfb drive feedback module, vendor 0h product 1h"
    )


def test_a_stopped_node_is_known_by_its_heartbeat() -> None:
    bench = Bench(sync=False)
    bench.module.dictionary.entry(0x1017).download((100).to_bytes(2, "little"))
    bench.bus.send(Frame(0x000, bytes((0x02, MODULE_ID))))
    stopped = scanned(bench)[MODULE_ID]
    assert stopped == FoundNode(MODULE_ID, "STOPPED")
    assert stopped.line() == " 32 (20h)  STOPPED          answers no SDO"


def test_a_node_that_a_master_guards_is_not_asked_for_its_state() -> None:
    bench = Bench(sync=False)
    bench.module.dictionary.entry(0x100C).value = 100
    frames = heard(bench)
    found = scanned(bench)
    assert found[MODULE_ID].state is None
    assert "state not known" in found[MODULE_ID].line()
    assert [frame.can_id for frame in frames if frame.rtr] == [0x700 + INTERFACE_ID]


def test_nothing_is_written_and_no_state_changes() -> None:
    bench = Bench(sync=False)
    frames = heard(bench)
    scanned(bench)
    requests = [frame for frame in frames if 0x600 <= frame.can_id < 0x680]
    assert len({frame.can_id for frame in requests}) == 127
    assert all(frame.data[0] in (0x40, 0x60, 0x70) for frame in requests), "uploads only"
    assert not any(frame.can_id == 0 for frame in frames)


def test_the_command(monkeypatch: pytest.MonkeyPatch, command: Command) -> None:
    opened = contextlib.nullcontext(EmbeddedMaster(Bench(sync=False).bus))
    monkeypatch.setattr("canfb.cli.node_command.BusMaster", lambda *_: opened)
    line = "node list -i virtual -c scan-x --seconds 0.3"
    assert [one[:9] for one in command(line).lines] == [" 16 (10h)", " 32 (20h)"]
    figures = command(f"{line} --json").json
    assert [one["node"] for one in figures] == [16, 32]
    assert figures[1]["state"] == "OPERATIONAL"


def test_an_empty_bus(command: Command) -> None:
    with can.Bus(interface="virtual", channel="scan-empty"):
        said = command("node list -i virtual -c scan-empty --seconds 0.1").out
    assert said.startswith("no node answers")
