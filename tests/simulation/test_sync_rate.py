"""The rate that a SYNC really has: said once when it is not the one that was asked for."""

from __future__ import annotations

import pytest

from canfb.cia301 import cob
from canfb.cia301.frame import Frame
from canfb.simulation.sync_producer import AGAIN_S, SyncProducer, SyncRateWatch

SYNC = Frame(cob.SYNC, b"")


def heard(asked_hz: float, held_hz: float, duration_s: float) -> tuple[SyncRateWatch, list[str]]:
    lines: list[str] = []
    watch = SyncRateWatch(asked_hz, lines.append)
    assert watch.start(100.0) == []
    for number in range(int(duration_s * held_hz)):
        assert watch.receive(SYNC, 100.0 + number / held_hz) == []
    return watch, lines


@pytest.mark.parametrize(("asked", "held"), [(500.0, 443.0), (1000.0, 970.0), (100.0, 50.0), (10.0, 11.0)])
def test_a_rate_that_is_not_held_is_said_once_with_both_figures(asked: float, held: float) -> None:
    watch, lines = heard(asked, held, 40.0)
    assert len(lines) == 1
    assert lines[0].startswith(f"SYNC: {held:.4g} Hz reached, {asked:g} Hz requested: ")
    assert watch.held_hz == pytest.approx(held)


@pytest.mark.parametrize(("asked", "held"), [(500.0, 500.0), (500.0, 495.0), (0.5, 0.5), (100.0, 101.0)])
def test_a_rate_that_is_held_is_not_spoken_of(asked: float, held: float) -> None:
    watch, lines = heard(asked, held, max(10.0, 250.0 / asked))
    assert lines == []
    assert watch.held_hz == pytest.approx(held)


def test_it_is_said_again_after_a_minute_and_not_before() -> None:
    assert len(heard(500.0, 443.0, AGAIN_S - 1.0)[1]) == 1
    assert len(heard(500.0, 443.0, AGAIN_S + 5.0)[1]) == 2


def test_a_producer_that_comes_late_is_noticed() -> None:
    """Its caller needs 2.2 ms for each round, and 2 ms were asked for."""
    lines: list[str] = []
    producer, watch = SyncProducer(0.002), SyncRateWatch(500.0, lines.append)
    now = 0.0
    producer.start(now)
    while now < 5.0:
        now += 0.0022
        for frame in producer.tick(now):
            watch.receive(frame, now)
    assert len(lines) == 1


def test_other_frames_do_not_count() -> None:
    lines: list[str] = []
    watch = SyncRateWatch(100.0, lines.append)
    for number in range(1000):
        watch.receive(Frame(0x181, b""), number / 100.0)
        watch.receive(Frame(cob.SYNC, b"", rtr=True), number / 100.0)
    assert watch.held_hz is None
    assert watch.tick(1.0) == []
    assert watch.deadline() is None
    with pytest.raises(ValueError, match="asked_hz"):
        SyncRateWatch(0.0, lines.append)
