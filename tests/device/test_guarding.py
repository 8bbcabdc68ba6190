"""Conformance cases Guard 01 to 06 and HvG 01 to 07, and what they leave open."""

from __future__ import annotations

from math import inf
from pathlib import Path

import pytest
import sample_eds
from device_kit import ID, OK, Bench
from hypothesis import given
from hypothesis import strategies as st

from canfb.cia301.nmt import NmtState
from canfb.device.od.dictionary import Dictionary

GUARD = 0x700 + ID
LOST, GOOD = "0A0#3081110000000000", "0A0#0000000000000000"


def guard(bench: Bench) -> list[str]:
    return bench.send(GUARD, rtr=True)


def set_up(bench: Bench, guard_time_ms: int = 100, factor: int = 3) -> None:
    assert bench.write(0x100C, 0, guard_time_ms, 2) == OK
    assert bench.write(0x100D, 0, factor, 1) == OK


def test_not_before_the_start(silent: Bench) -> None:
    assert guard(silent) == []


def test_without_100c_there_is_no_guarding(tmp_path: Path) -> None:
    rows = [row for row in sample_eds.ROWS if row[0] not in (0x100C, 0x100D)]
    bench = Bench(Dictionary.load(sample_eds.write(tmp_path / "none.eds", rows), ID))
    bench.start()
    assert guard(bench) == []


# Life guarding


def test_a_stopped_node_tells_later(bench: Bench) -> None:
    set_up(bench)
    bench.nmt(2)
    assert guard(bench) == ["720#04"]
    assert bench.run(10.0) == []
    assert bench.node.state is NmtState.STOPPED
    assert bench.nmt(128) == [LOST]
    assert guard(bench) == ["720#FF", GOOD]


def test_a_new_life_time_runs_from_the_write_on(bench: Bench) -> None:
    set_up(bench)
    guard(bench)
    bench.run(0.2)
    assert bench.write(0x100C, 0, 200, 2) == OK
    assert bench.run(10.0) == [(0.8, LOST)]


def test_an_error_lasts_until_the_next_remote_frame(bench: Bench) -> None:
    set_up(bench)
    guard(bench)
    bench.run(1.0)
    assert bench.write(0x100C, 0, 200, 2) == OK
    assert bench.read(0x1001) == 0x11
    assert bench.node.deadline() is None
    assert guard(bench) == ["720#FF", GOOD]


@pytest.mark.parametrize("command", [129, 130])
def test_a_reset_waits_for_the_first_remote_frame(bench: Bench, command: int) -> None:
    for index, value in ((0x100C, 100), (0x100D, 3)):
        bench.dictionary.entry(index).default = value
    set_up(bench)
    guard(bench)
    bench.nmt(command)
    assert bench.run(10.0) == []
    guard(bench)
    assert len(bench.run(10.0)) == 1
    assert bench.nmt(command) == ["720#00"]
    assert bench.read(0x1001) == 0


# With a heartbeat


def test_a_stored_heartbeat(silent: Bench) -> None:
    entry = silent.dictionary.entry(0x1017)
    entry.default = entry.value = 200
    silent.start()
    assert guard(silent) == []
    assert silent.run(0.2) == [(0.2, "720#7F")]


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
    set_up(bench, guard_ms, factor)
    bench.write(0x1016, 1, 0x470000 | beat_ms, 4)
    bench.write(0x1029, 1, int(stays), 1)
    bench.operational()
    model = ErrorControlModel({0x47: beat_ms / 1000, 0: guard_ms * factor / 1000}, stays)
    seen: list[tuple[float, str]] = []
    for wait_ms, sign in signs:
        seen += bench.run(wait_ms / 1000)
        model.advance(bench.now)
        frames: list[str] = []
        if sign == "start":
            bench.nmt(1)
            model.state = 0x05
        elif sign != "none":
            model.sign(0 if sign == "guard" else 0x47, bench.now)
            frames = guard(bench) if sign == "guard" else bench.send(0x747, "05")
        seen += [(bench.now, text) for text in frames]
    rounded = [[(round(at, 5), text) for at, text in frames] for frames in (seen, model.sent)]
    assert sorted(rounded[0]) == sorted(rounded[1])
    assert bench.node.state == model.state
