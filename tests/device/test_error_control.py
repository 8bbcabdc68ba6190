"""Heartbeat, guarding and bus-off, beyond the cases HB, Guard and HvG of tests/conformance."""

from __future__ import annotations

from math import inf
from pathlib import Path

import pytest
import sample_eds
from device_kit import ID, OK, Bench, hexes
from hypothesis import given
from hypothesis import strategies as st

from canfb.cia301.nmt import NmtState
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary

WATCHED = 0x47
LOST, GUARD_LOST, GOOD = "0A0#3081114700000000", "0A0#3081110000000000", "0A0#0000000000000000"
BUS_BACK = ["0A0#4081110000000000", GOOD]


def guard(bench: Bench) -> list[str]:
    return bench.send(0x700 + ID, rtr=True)


def guarded(bench: Bench, guard_time_ms: int = 100, factor: int = 3) -> None:
    assert bench.write(0x100C, 0, guard_time_ms, 2) == OK
    assert bench.write(0x100D, 0, factor, 1) == OK


def beat(bench: Bench) -> list[str]:
    return bench.send(0x700 + WATCHED, "05")


def watching(bench: Bench, milliseconds: int) -> None:
    bench.write(0x1016, 1, WATCHED << 16 | milliseconds, 4)


class ErrorControlModel:
    """Two watchers, seconds from sign to loss, and what the node sends; it is OPERATIONAL at first."""

    def __init__(self, limits_s: dict[int, float], stays: bool) -> None:
        self.limits_s, self.stays = limits_s, stays
        self.ends, self.lost = dict.fromkeys(limits_s, inf), set[int]()
        self.sent: list[tuple[float, str]] = []
        self.state, self.toggle = 0x05, 0x00

    def advance(self, now: float) -> None:
        while min(self.ends.values()) <= now:
            at, node = min((end, node) for node, end in self.ends.items())
            self.ends[node] = inf
            self.lost.add(node)
            self.sent.append((at, f"0A0#308111{node:02X}00000000"))
            self.state = self.state if self.stays else 0x7F

    def sign(self, node: int, now: float) -> None:
        """A heartbeat of a node, or a remote frame of the master (0), which is answered."""
        if not node:
            self.sent.append((now, f"720#{self.state | self.toggle:02X}"))
            self.toggle ^= 0x80
        self.ends[node] = now + self.limits_s[node] if self.limits_s[node] else inf
        if node in self.lost:
            self.lost.discard(node)
            self.sent.append((now, f"0A0#0000{0x11 if self.lost else 0:02X}0000000000"))


SIGNS = st.lists(
    st.tuples(st.integers(0, 150), st.sampled_from(["none", "beat", "guard", "start"])), max_size=25
)


@given(st.integers(1, 120), st.integers(0, 60), st.integers(0, 3), st.booleans(), SIGNS)
def test_whatever_comes_and_does_not_come(
    sample_path: Path, beat_ms: int, guard_ms: int, factor: int, stays: bool, signs: list[tuple[int, str]]
) -> None:
    bench = Bench(Dictionary.load(sample_path, ID))
    bench.start()
    guarded(bench, guard_ms, factor)
    watching(bench, beat_ms)
    bench.write(0x1029, 1, int(stays), 1)
    bench.operational()
    model = ErrorControlModel({WATCHED: beat_ms / 1000, 0: guard_ms * factor / 1000}, stays)
    seen: list[tuple[float, str]] = []
    for wait_ms, sign in signs:
        seen += bench.run(wait_ms / 1000)
        model.advance(bench.now)
        frames: list[str] = []
        if sign == "start":
            bench.nmt(1)
            model.state = 0x05
        elif sign != "none":
            model.sign(0 if sign == "guard" else WATCHED, bench.now)
            frames = guard(bench) if sign == "guard" else beat(bench)
        seen += [(bench.now, text) for text in frames]
    rounded = [[(round(at, 5), text) for at, text in frames] for frames in (seen, model.sent)]
    assert sorted(rounded[0]) == sorted(rounded[1])
    assert bench.node.state == model.state
    assert bench.read(0x1001) == (0x11 if model.lost else 0)


def test_no_guarding_before_the_start_beside_a_heartbeat_or_without_100ch(
    silent: Bench, tmp_path: Path
) -> None:
    assert guard(silent) == []
    entry = silent.dictionary.entry(0x1017)
    entry.default = entry.value = 200
    silent.start()
    assert guard(silent) == []
    assert silent.run(0.2) == [(0.2, "720#7F")]
    rows = [row for row in sample_eds.ROWS if row[0] not in (0x100C, 0x100D)]
    bench = Bench(Dictionary.load(sample_eds.write(tmp_path / "none.eds", rows), ID))
    bench.start()
    assert guard(bench) == []


def test_a_stopped_node_tells_later(bench: Bench) -> None:
    guarded(bench)
    bench.nmt(2)
    assert guard(bench) == ["720#04"]
    assert bench.run(10.0) == []
    assert bench.node.state is NmtState.STOPPED
    assert bench.nmt(128) == [GUARD_LOST]
    assert guard(bench) == ["720#FF", GOOD]


def test_a_new_life_time_runs_from_the_write_on_and_ends_no_error(bench: Bench) -> None:
    guarded(bench)
    guard(bench)
    bench.run(0.2)
    assert bench.write(0x100C, 0, 200, 2) == OK
    assert bench.run(10.0) == [(0.8, GUARD_LOST)]
    assert bench.write(0x100C, 0, 100, 2) == OK
    assert bench.read(0x1001) == 0x11
    assert bench.node.deadline() is None
    assert guard(bench) == ["720#FF", GOOD]


@pytest.mark.parametrize("command", [129, 130])
def test_a_reset_waits_for_the_first_remote_frame(bench: Bench, command: int) -> None:
    for index, value in ((0x100C, 100), (0x100D, 3)):
        bench.dictionary.entry(index).default = value
    guarded(bench)
    guard(bench)
    bench.nmt(command)
    assert bench.run(10.0) == []
    guard(bench)
    assert len(bench.run(10.0)) == 1
    assert bench.nmt(command) == ["720#00"]
    assert bench.read(0x1001) == 0


def test_heartbeats_neither_drift_nor_catch_up(bench: Bench) -> None:
    bench.write(0x1017, 0, 100, 2)
    bench.run(0.0)
    for late in [*(number * 0.1 + 0.03 for number in range(1, 20)), 5.03]:
        bench.now = late
        assert bench.tick() == ["720#7F"]
        assert bench.node.deadline() == pytest.approx(5.13 if late == 5.03 else late + 0.07)


def test_the_program_hears_of_a_loss_before_the_state_changes(bench: Bench) -> None:
    heard: list[tuple[float, NmtState]] = []
    bench.application.react(communication_failed=lambda now: heard.append((now, bench.node.state)))
    watching(bench, 1000)
    bench.operational()
    beat(bench)
    assert bench.run(3.0) == [(1.0, LOST)]
    assert heard == [(1.0, NmtState.OPERATIONAL)]
    assert bench.read(0x1003, 1) == 0x00478130
    bench.node.bus_off(bench.now)
    assert heard[1:] == [(bench.now, NmtState.PRE_OPERATIONAL)]


def test_a_malformed_heartbeat_does_not_count_and_a_watch_that_ends_ends_its_error(bench: Bench) -> None:
    watching(bench, 100)
    for data in ("", "0505"):
        bench.send(0x700 + WATCHED, data)
    assert bench.node.counters.malformed_frames == 2
    assert bench.node.deadline() is None
    beat(bench)
    assert len(bench.run(1.0)) == 1
    assert GOOD in bench.send(0x620, "2316100100000000")
    assert bench.read(0x1001) == 0


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
def test_bus_off_is_a_communication_error_and_its_end_is_told(
    bench: Bench, behaviour: int, before: int, after: NmtState
) -> None:
    assert bench.write(0x1029, 1, behaviour, 1) is OK
    bench.nmt(before)
    for now in (1.0, 1.1):
        assert bench.node.bus_off(now) == []
        assert bench.node.state is after
    told = [] if after is NmtState.STOPPED else BUS_BACK
    assert hexes(bench.node.bus_back(2.0)) == told
    assert bench.node.state is after, "a master starts it again"
    if told:
        assert (bench.read(0x1001), bench.read(0x1003, 1)) == (0, 0x8140)
    bench.node.bus_off(4.0)
    assert hexes(bench.node.bus_back(5.0)) == told
    assert bench.run(10.0) == []


def test_without_a_node_id_nobody_is_told(sample_path: Path) -> None:
    node = Node(Dictionary.load(sample_path, 255), 255)
    node.start(0.0)
    assert node.bus_off(1.0) == node.bus_back(2.0) == []
    assert node.state is NmtState.INITIALISING
