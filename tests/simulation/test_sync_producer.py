"""The SYNC producer: steady, and never in bursts."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.cia301.frame import Frame
from canfb.simulation.sync_producer import SyncProducer

SYNC = [Frame(0x80, b"")]


@given(st.floats(1e-5, 10), st.floats(0, 1e4), st.lists(st.floats(0, 100) | st.none(), max_size=50))
def test_one_sync_at_a_time_in_an_unbroken_rhythm(
    period: float, start: float, waits: list[float | None]
) -> None:
    """The first comes one period after power-on; what is overdue is left out. None: it is served on time."""
    producer = SyncProducer(period)
    assert producer.deadline() is None
    assert producer.tick(start) == producer.start(start) == []
    due, now = producer.deadline(), start
    for wait in waits:
        assert due is not None
        assert now < due <= now + period * (1 + 1e-6) + 1e-9
        assert (due - start) / period == pytest.approx(round((due - start) / period), abs=1e-3)
        now = due if wait is None else now + wait * period
        assert producer.tick(now) == (SYNC if now >= due else [])
        assert producer.tick(now) == []
        due = producer.deadline()


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
