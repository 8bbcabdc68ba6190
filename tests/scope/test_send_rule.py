"""What may be sent without --write changes nothing in a module, whatever the frames are."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

import canfb
from canfb.cia301.frame import Frame
from canfb.module.feedback_module import FeedbackModule
from canfb.scope.scoping import SendRule, send_rule

NODE = 0x20
UPLOAD, DOWNLOAD = bytes.fromhex("4018100100000000"), bytes.fromhex("2310100173617665")
PLACES = st.sampled_from(
    [(0x1010, 1), (0x1017, 0), (0x2001, 1), (0x2010, 1), (0x2020, 1), (0x2020, 3), (0x2050, 1)]
)


def test_the_options_make_the_rule() -> None:
    assert send_rule(asks=False, writes=False) is SendRule.NOTHING
    assert send_rule(asks=True, writes=False) is SendRule.READS
    assert send_rule(asks=True, writes=True) is SendRule.ALL


@given(can_id=st.integers(0, 0x7FF), data=st.binary(max_size=8))
def test_who_only_listens_sends_nothing(can_id: int, data: bytes) -> None:
    assert not SendRule.NOTHING.permits(can_id, data)
    assert SendRule.ALL.permits(can_id, data)


@pytest.mark.parametrize(
    ("can_id", "data", "permitted"),
    [
        (0x600 + NODE, UPLOAD, True),
        (0x600 + NODE, bytes.fromhex("A0202001 7F000000"), True),  # block upload
        (0x600 + NODE, bytes.fromhex("6000000000000000"), True),  # its segments
        (0x600 + NODE, DOWNLOAD, False),
        (0x600 + NODE, bytes.fromhex("C2202001 00100000"), False),  # block download
        (0x600 + NODE, bytes.fromhex("0000000000000000"), False),  # a segment of a download
        (0x000, bytes.fromhex("8120"), False),  # NMT
        (0x080, b"", False),  # SYNC
        (0x600, UPLOAD, False),
        (0x680, UPLOAD, False),
        (0x580 + NODE, UPLOAD, False),  # in the name of a node
        (0x600 + NODE, UPLOAD[:7], False),
        (0x600 + NODE, b"", False),
        (0x7E5, UPLOAD, False),  # LSS
    ],
)
def test_who_reads_only_uploads(can_id: int, data: bytes, permitted: bool) -> None:
    assert SendRule.READS.permits(can_id, data) is permitted


def values_of(module: FeedbackModule) -> dict[tuple[int, int], object]:
    return {(one.index, one.subindex): one.value for one in module.dictionary}


@given(
    frames=st.lists(
        st.one_of(
            st.tuples(st.integers(0x600, 0x680), st.binary(min_size=8, max_size=8)),
            st.tuples(
                st.just(0x600 + NODE),
                st.builds(
                    lambda command, place, rest: (
                        bytes([command, place[0] & 255, place[0] >> 8, place[1]]) + rest
                    ),
                    st.integers(0, 255),
                    PLACES,
                    st.binary(min_size=4, max_size=4),
                ),
            ),
        ),
        max_size=30,
    )
)
def test_no_permitted_frame_changes_a_value(frames: list[tuple[int, bytes]]) -> None:
    module = canfb.FeedbackModule(canfb.ModuleConfig(node_id=NODE))
    module.start(0.0)
    before = values_of(module)
    for number, (can_id, data) in enumerate(frames):
        if SendRule.READS.permits(can_id, data):
            module.receive(Frame(can_id, data), 0.001 * number)
    assert values_of(module) == before
