from __future__ import annotations

import pytest
from device_kit import Bench

from canfb.cia301.nmt import NmtState


def watch(node_id: int, milliseconds: int) -> int:
    return node_id << 16 | milliseconds


def test_a_late_tick_sends_one_heartbeat(bench: Bench) -> None:
    bench.write(0x1017, 0, 100, 2)
    bench.run(0.0)
    bench.now = 5.03
    assert bench.tick() == ["720#7F"]
    assert bench.node.deadline() == pytest.approx(5.13)


def test_the_period_does_not_drift(bench: Bench) -> None:
    bench.write(0x1017, 0, 100, 2)
    bench.run(0.0)
    for number in range(1, 20):
        bench.now = number * 0.1 + 0.03
        assert bench.tick() == ["720#7F"]
    assert bench.node.deadline() == pytest.approx(2.0)


def test_a_lost_heartbeat(bench: Bench) -> None:
    bench.write(0x1016, 1, watch(0x47, 1000), 4)
    bench.operational()
    bench.send(0x747, "05")
    assert bench.run(3.0) == [(1.0, "0A0#3081114700000000")]
    assert bench.node.state is NmtState.PRE_OPERATIONAL
    assert bench.read(0x1001) == 0x11
    assert bench.read(0x1003, 1) == 0x00478130
    assert bench.send(0x747, "05") == ["0A0#0000000000000000"]
    assert bench.read(0x1001) == 0
    bench.now += 0.5
    assert bench.send(0x747, "05") == []
    assert bench.run(0.9) == []


def test_the_program_hears_of_the_loss_before_the_state_changes(bench: Bench) -> None:
    heard: list[tuple[float, NmtState]] = []
    bench.application.react(communication_failed=lambda now: heard.append((now, bench.node.state)))
    bench.write(0x1016, 1, watch(5, 100), 4)
    bench.operational()
    bench.send(0x705, b"\x05")
    start = bench.now
    bench.run(1.0)
    assert heard == [(start + 0.1, NmtState.OPERATIONAL)]
    assert bench.node.state is NmtState.PRE_OPERATIONAL
    bench.node.bus_off(bench.now)
    assert heard[1:] == [(bench.now, NmtState.PRE_OPERATIONAL)]


def test_a_malformed_heartbeat_does_not_count(bench: Bench) -> None:
    bench.write(0x1016, 1, watch(0x47, 100), 4)
    bench.send(0x747, "")
    bench.send(0x747, "0505")
    assert bench.node.counters.malformed_frames == 2
    assert bench.node.deadline() is None


def test_an_error_ends_when_the_node_is_no_longer_watched(bench: Bench) -> None:
    bench.write(0x1016, 1, watch(0x47, 100), 4)
    bench.send(0x747, "05")
    assert len(bench.run(1.0)) == 1
    assert "0A0#0000000000000000" in bench.send(0x620, "2316100100000000")
    assert bench.read(0x1001) == 0
