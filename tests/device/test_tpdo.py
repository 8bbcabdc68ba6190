"""Transmit PDOs by type; what an event, a remote frame and the timers send, against a model of them."""

from __future__ import annotations

from math import inf
from pathlib import Path

import pytest
from device_kit import OK, Bench
from hypothesis import given
from hypothesis import strategies as st

from canfb.device.od.dictionary import Dictionary

OFF_1, ON_1 = 0xC00001A0, 0x400001A0
OFF_2, ON_2 = 0x800002A0, 0x000002A0


def set_up(bench: Bench, *, kind: int, inhibit: int = 0, timer: int = 0, start: int = 0) -> None:
    """TPDO2 with remote frames allowed, one U32."""
    assert bench.write(0x1801, 1, OFF_2, 4) == OK
    for subindex, value, size in ((2, kind, 1), (3, inhibit, 2), (5, timer, 2), (6, start, 1)):
        assert bench.write(0x1801, subindex, value, size) == OK
    assert bench.write(0x1801, 1, ON_2, 4) == OK


def set_value(bench: Bench, value: int) -> None:
    bench.dictionary.entry(0x2010, 1).value = value


@pytest.mark.parametrize("option", [{"start": 4}, {"inhibit": 10000}])
def test_what_is_not_for_synchronous_ones_without_a_counter(bench: Bench, option: dict[str, int]) -> None:
    set_up(bench, kind=1, **option)
    bench.operational()
    assert bench.sync() == bench.sync() == ["2A0#00000000"]


@pytest.mark.parametrize("kind", [0, 1, 0xFD, 254, 255])
def test_a_remote_frame(bench: Bench, kind: int) -> None:
    set_up(bench, kind=kind)
    bench.operational()
    set_value(bench, 9)
    assert bench.send(0x2A0, rtr=True) == ["2A0#09000000"]
    assert bench.send(0x1A0, rtr=True) == [], "not allowed"
    assert bench.node.counters.remote_frames == 1


def test_sampled_at_the_sync_and_sent_on_a_remote_frame(bench: Bench) -> None:
    set_up(bench, kind=0xFC)
    bench.operational()
    set_value(bench, 9)
    assert bench.send(0x2A0, rtr=True) == bench.sync() == []
    set_value(bench, 10)
    assert bench.send(0x2A0, rtr=True) == ["2A0#09000000"]
    bench.sync()
    assert bench.send(0x2A0, rtr=True) == ["2A0#0A000000"]


def test_an_invalid_tpdo_is_silent_and_one_that_is_not_there_cannot_be_sent(bench: Bench) -> None:
    bench.write(0x1800, 1, OFF_1, 4)
    bench.operational()
    bench.node.trigger_tpdo(1, 0.0)
    assert bench.tick() == []
    bench.write(0x1800, 1, ON_1, 4)
    bench.node.trigger_tpdo(1, 0.0)
    assert bench.tick() == ["1A0#0000000000000000"]
    with pytest.raises(ValueError, match=r"no TPDO 3.*\[1, 2\]"):
        bench.node.trigger_tpdo(3, 0.0)


class TimerModel:
    """When an event-driven TPDO is sent (CiA 301, 7.2.2): inhibit time and event timer, seconds; 0: none."""

    def __init__(self, inhibit_s: float, timer_s: float) -> None:
        self.inhibit_s, self.timer_s = inhibit_s, timer_s
        self.sent: list[float] = []
        self.waits, self.not_before, self.timer_end = False, -inf, timer_s or inf

    def ask(self, now: float) -> None:
        if now < self.not_before:
            self.waits = True
            return
        self.waits = False
        self.sent.append(now)
        self.not_before = now + self.inhibit_s if self.inhibit_s else -inf
        self.timer_end = now + self.timer_s if self.timer_s else inf

    def advance(self, end: float) -> None:
        while (due := min(self.not_before if self.waits else inf, self.timer_end)) <= end:
            if due >= self.timer_end:
                self.timer_end = inf
            self.ask(due)


STEPS = st.lists(st.tuples(st.integers(0, 40), st.sampled_from(["event", "remote", "none"])), max_size=25)


@given(st.integers(0, 30), st.integers(0, 50), STEPS)
def test_any_events_are_sent_as_the_model_says(
    sample_path: Path, inhibit_ms: int, timer_ms: int, steps: list[tuple[int, str]]
) -> None:
    bench = Bench(Dictionary.load(sample_path, 32))
    bench.start()
    set_up(bench, kind=254, inhibit=10 * inhibit_ms, timer=timer_ms)
    bench.operational()
    model, seen = TimerModel(inhibit_ms / 1000, timer_ms / 1000), list[float]()
    for wait_ms, what in steps:
        seen += [at for at, _ in bench.run(wait_ms / 1000)]
        model.advance(bench.now)
        if what != "none":
            model.ask(bench.now)
            if what == "event":
                bench.node.trigger_tpdo(2, bench.now)
            frames = bench.tick() if what == "event" else bench.send(0x2A0, rtr=True)
            seen += [bench.now] * len(frames)
    assert seen == pytest.approx(model.sent)
