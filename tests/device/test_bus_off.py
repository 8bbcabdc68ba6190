"""The bus goes and comes back: 1029h and EMCY 8140h."""

from __future__ import annotations

from pathlib import Path

import pytest
from device_kit import OK, Bench, hexes

from canfb.cia301.nmt import NmtState
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary

RECOVERED = ["0A0#4081110000000000", "0A0#0000000000000000"]


@pytest.mark.parametrize(
    ("behaviour", "before", "after"),
    [
        (0, 1, NmtState.PRE_OPERATIONAL),
        (0, 2, NmtState.STOPPED),
        (1, 1, NmtState.OPERATIONAL),
        (2, 1, NmtState.STOPPED),
        (2, 128, NmtState.STOPPED),
    ],
)
def test_bus_off_is_a_communication_error(bench: Bench, behaviour: int, before: int, after: NmtState) -> None:
    assert bench.write(0x1029, 1, behaviour, 1) is OK
    bench.nmt(before)
    assert bench.node.bus_off(1.0) == []
    assert bench.node.state is after
    bench.node.bus_off(1.1)
    assert bench.node.state is after


def test_the_return_is_told_once_and_changes_no_state(bench: Bench) -> None:
    bench.operational()
    bench.node.bus_off(1.0)
    assert hexes(bench.node.bus_back(2.0)) == RECOVERED
    assert bench.node.state is NmtState.PRE_OPERATIONAL, "a master starts it again"
    assert bench.read(0x1001) == 0
    assert bench.read(0x1003, 1) == 0x8140
    assert bench.run(10.0) == []


def test_the_next_time_it_is_told_again(bench: Bench) -> None:
    for now in (1.0, 3.0):
        bench.node.bus_off(now)
        assert hexes(bench.node.bus_back(now + 1.0)) == RECOVERED


def test_without_a_node_id_nobody_is_told(sample_path: Path) -> None:
    node = Node(Dictionary.load(sample_path, 255), 255)
    node.start(0.0)
    assert node.bus_off(1.0) == node.bus_back(2.0) == []
    assert node.state is NmtState.INITIALISING
