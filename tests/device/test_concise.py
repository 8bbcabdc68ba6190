"""The concise DCF: bytes as CiA 302-3 has them, there and back."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.device.od.writes import Write, decode_concise, encode_concise

WRITES = st.lists(st.builds(Write, st.integers(0, 0xFFFF), st.integers(0, 0xFF), st.binary(max_size=20)))


def test_the_bytes_of_the_standard() -> None:
    writes = [Write(0x1017, 0, b"\xf4\x01"), Write(0x1400, 1, bytes.fromhex("90010080"))]
    wanted = "02000000 1710 00 02000000 f401 0014 01 04000000 90010080"
    assert encode_concise(writes) == bytes.fromhex(wanted.replace(" ", ""))


@given(WRITES)
def test_there_and_back(writes: list[Write]) -> None:
    assert decode_concise(encode_concise(writes)) == writes


@given(WRITES, st.integers(1, 30))
def test_a_part_of_it_is_refused(writes: list[Write], cut: int) -> None:
    data = encode_concise(writes)
    with pytest.raises(ValueError, match="concise DCF"):
        decode_concise(data[: max(0, len(data) - cut)])
    with pytest.raises(ValueError, match="follow the last entry"):
        decode_concise(data + bytes(cut))


@given(st.binary(max_size=60))
def test_any_bytes_are_one_or_are_refused(data: bytes) -> None:
    try:
        writes = decode_concise(data)
    except ValueError:
        return
    assert encode_concise(writes) == data
