"""Frames of a program are checked; those of a bus are dropped and counted."""

from __future__ import annotations

from typing import cast

import pytest

import canfb
from canfb import FeedbackModule, Frame


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
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
    ],
)
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
