"""Frames of a program are checked, and receive times that a clock cannot have are not used."""

from typing import cast

import pytest
from hypothesis import given, strategies as st

import canfb
from canfb import FeedbackModule, Frame
from canfb.device.core import STAMP_NOISE_S, CallContext
from folding import each


@each("arguments, error, words", [
    ((0x123, bytes(9)), ValueError, "0 to 8 bytes, not 9"),
    ((0x800, b""), ValueError, "0 to 7FFh .*, not 800h"),
    ((-1, b""), ValueError, "can_id"),
    (("123", b""), TypeError, "can_id"),
    ((True, b""), TypeError, "can_id"),
    ((0x123, "data"), TypeError, "data must be bytes, not str"),
    ((0x123, 8), TypeError, "data must be bytes, not int"),
    ((0x123, [1, 2]), TypeError, "data must be bytes, not list"),
    ((0x123, b"", 1), TypeError, "rtr"),
    ((0x123, b"", False, "now"), TypeError, "timestamp"),
])  # fmt: skip
def test_a_frame_that_is_none_is_refused(
    arguments: tuple[object, ...], error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        Frame.checked(*arguments)  # type: ignore[arg-type]


def test_a_checked_frame_is_a_frame() -> None:
    for can_id, data in ((0, b""), (0x7FF, bytes(8)), (0x123, b"\x01")):
        assert Frame.checked(can_id, cast(bytes, bytearray(data))) == Frame(can_id, data)
    frame = Frame.checked(0x701, rtr=True, timestamp=1.5)
    assert (frame, type(frame.data)) == (Frame(0x701, b"", True, 1.5), bytes)


@pytest.mark.parametrize("config", [None, {"node_id": 32}, 32, canfb.ChainConfig(), "feedback.yaml"])
def test_a_configuration_that_is_none_is_refused(config: object) -> None:
    with pytest.raises(TypeError, match="config must be a ModuleConfig, not"):
        FeedbackModule(config)  # type: ignore[arg-type]


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
    st.floats(0.01, 1e4) | st.floats(-1e4, -0.01), st.lists(st.floats(1e-4, 2e-3), min_size=2, max_size=50)
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


def test_noise_of_stamps_does_not_turn_time_back() -> None:
    call = CallContext()
    for part in (0.0, 0.0, 0.5, 1.0):
        assert taken(call, 100.0 - part * 0.9 * STAMP_NOISE_S, 100.01)
        assert call.received == 100.0
