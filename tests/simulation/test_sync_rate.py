"""A SYNC producer that watches itself: one line if its rate is not reached, or another node sends SYNC."""

from __future__ import annotations

import pytest

from canfb.cia301 import cob
from canfb.cia301.frame import Frame
from canfb.simulation.sync_producer import AGAIN_S, WatchedSyncProducer

SYNC = Frame(cob.SYNC, b"")


class Watched:
    """The producer of ``asked_hz`` in a program that serves it ``held_hz`` times a second."""

    def __init__(self, asked_hz: float) -> None:
        self.lines: list[str] = []
        self.now = 100.0
        self.producer = WatchedSyncProducer(1.0 / asked_hz, self.lines.append)
        assert self.producer.start(self.now) == []

    def run(self, seconds: float, held_hz: float, *others: Frame) -> None:
        end_s = self.now + seconds
        while self.now < end_s:
            self.now = max(self.now + 1.0 / held_hz, self.producer.deadline() or 0.0)
            for frame in others:
                assert self.producer.receive(frame, self.now) == []
            assert self.producer.tick(self.now) == [SYNC]


@pytest.mark.parametrize(
    ("asked", "held", "seconds", "times"),
    [
        (500.0, 443.0, 40.0, 1),
        (1000.0, 970.0, 40.0, 1),
        (100.0, 50.0, AGAIN_S - 1.0, 1),
        (100.0, 50.0, AGAIN_S + 5.0, 2),
        (500.0, 1000.0, 10.0, 0),
        (100.0, 99.5, 10.0, 0),
        (0.5, 10.0, 500.0, 0),
    ],
)
def test_a_rate_that_is_not_reached_is_said_once_a_minute(
    asked: float, held: float, seconds: float, times: int
) -> None:
    watched = Watched(asked)
    watched.run(seconds, held)
    assert len(watched.lines) == times
    for line in watched.lines:
        assert line.startswith("SYNC: ")
        assert line.endswith(f" Hz reached, {asked:g} Hz requested: this computer does not keep up"
                             "; set a lower --rate, or --pace sync")  # fmt: skip


@pytest.mark.parametrize("foreign", [True, False])
def test_the_sync_of_another_node_is_named_and_not_taken_for_a_slow_computer(foreign: bool) -> None:
    watched = Watched(100.0)
    watched.run(10.0, 1000.0, Frame(0x181, b""), Frame(cob.SYNC, b"", rtr=True), *[SYNC] * foreign)
    said = "SYNC: another node sends it too, 100 Hz beside the 100 Hz sent here; end one of the two"
    assert watched.lines == [said] * foreign


def test_while_the_bus_is_gone_nothing_is_said_and_then_a_new_window_begins() -> None:
    watched = Watched(100.0)
    watched.run(1.0, 1000.0)
    assert watched.producer.bus_off(watched.now) == []
    watched.run(20.0, 5.0, SYNC)
    assert watched.producer.bus_back(watched.now) == []
    watched.run(10.0, 1000.0)
    assert watched.lines == []
    watched.run(10.0, 50.0)
    assert len(watched.lines) == 1
