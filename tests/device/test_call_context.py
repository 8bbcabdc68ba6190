"""Receive times of a frame: those that a clock cannot have are not used."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.device.core import STAMP_NOISE_S, CallContext


def taken(call: CallContext, stamp: float, now: float) -> bool:
    """Give a frame with this time stamp to the node, as it does; whether the stamp is used."""
    call.now = now
    call.stamped(stamp)
    return call.is_stamped


@given(st.lists(st.tuples(st.floats(1e-5, 2e-3), st.floats(0.0, 1e-2)), min_size=1, max_size=50))
def test_stamps_of_a_right_clock_are_used_however_late_the_host_is(steps: list[tuple[float, float]]) -> None:
    call, at, now = CallContext(), 100.0, 0.0
    for apart_s, late_s in steps:
        at += apart_s
        now = max(now, at + late_s)
        assert taken(call, at, now)
        assert call.received == at


@given(
    st.floats(0.01, 1e4) | st.floats(-1e4, -0.01),
    st.lists(st.floats(1e-4, 2e-3), min_size=2, max_size=50),
)
def test_a_clock_that_is_set_is_not_used_until_it_is_right(back_s: float, steps: list[float]) -> None:
    call, at = CallContext(), 1e5
    assert taken(call, at, at)
    for apart_s in steps:
        before, at = call.received, at + apart_s
        assert not taken(call, at - back_s, at)
        assert call.received == at > before, "time goes on"
    at += 1e-3
    assert taken(call, at, at)


@pytest.mark.parametrize("part", [0.0, 0.5, 1.0])
def test_noise_of_stamps_does_not_turn_time_back(part: float) -> None:
    call = CallContext()
    assert taken(call, 100.0, 100.01)
    assert taken(call, 100.0 - part * 0.9 * STAMP_NOISE_S, 100.01)
    assert call.received == 100.0
