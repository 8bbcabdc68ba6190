"""The SYNC producer: steady, and never in bursts."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.cia301.frame import Frame
from canfb.simulation.sync_producer import SyncProducer

SYNC = [Frame(0x80, b"")]


def test_the_first_sync_comes_one_period_after_power_on() -> None:
    producer = SyncProducer(0.01)
    assert producer.deadline() is None
    assert producer.tick(1.0) == []
    assert producer.start(5.0) == []
    assert producer.deadline() == 5.01
    assert producer.tick(5.009) == []
    assert producer.tick(5.01) == SYNC
    assert producer.deadline() == pytest.approx(5.02)


def test_on_time_it_keeps_its_rate() -> None:
    producer = SyncProducer(0.001)
    producer.start(0.0)
    times = []
    while (at := producer.deadline() or 0.0) < 10.0:
        assert producer.tick(at) == SYNC
        times.append(at)
    assert len(times) in {9999, 10_000}
    assert times[-1] == pytest.approx(len(times) * 0.001, abs=1e-9)


@pytest.mark.parametrize("late", [0.0, 0.4, 0.999, 1.0, 1.5, 7.0, 1000.25])
def test_syncs_that_are_overdue_are_left_out_and_the_rhythm_is_kept(late: float) -> None:
    period = 0.25
    producer = SyncProducer(period)
    producer.start(0.0)
    now = period + late * period
    assert producer.tick(now) == SYNC
    following = producer.deadline()
    assert following is not None
    assert now < following <= now + period
    assert following % period == 0.0
    assert producer.tick(now) == []


@given(st.floats(1e-5, 10), st.floats(0, 1e6), st.lists(st.floats(0, 100), max_size=50))
def test_there_is_never_a_second_sync_without_a_wait(period: float, start: float, waits: list[float]) -> None:
    producer = SyncProducer(period)
    producer.start(start)
    now = start
    for wait in waits:
        now += wait * period
        sent = producer.tick(now)
        deadline = producer.deadline()
        assert deadline is not None
        assert deadline > now
        assert deadline - now <= period * (1 + 1e-6) + 1e-9
        assert len(sent) <= 1
        assert producer.tick(now) == []


@given(st.binary(max_size=8), st.integers(0, 0x7FF))
def test_nothing_on_the_bus_concerns_it(data: bytes, can_id: int) -> None:
    producer = SyncProducer(0.1)
    producer.start(0.0)
    assert producer.receive(Frame(can_id, data), 0.05) == []
    assert producer.deadline() == 0.1


@pytest.mark.parametrize("period", [0.0, -1.0, math.nan, math.inf])
def test_a_period_that_there_cannot_be_is_refused(period: float) -> None:
    with pytest.raises(ValueError, match="period_s must be positive"):
        SyncProducer(period)
