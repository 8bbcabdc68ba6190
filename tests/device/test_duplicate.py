"""Another node with the same node-ID: it is noticed by any frame that only this node may send."""

from __future__ import annotations

from copy import deepcopy
from pathlib import Path

from device_kit import ID, Bench, hexes
from hypothesis import given
from hypothesis import strategies as st

from canfb.cia301.frame import Frame
from canfb.cia301.nmt import NmtState
from canfb.device.od.dictionary import Dictionary
from drawing import examples

SHIPPED = Path(__file__).parents[2] / "eds" / "canfb-module.eds"
PRISTINE = Dictionary.load(SHIPPED, ID)
OWN = {0x0A0, 0x1A0, 0x2A0, 0x5A0, 0x720}
"""Of the module with its defaults: EMCY, two TPDOs, SDO answers, boot-up and heartbeat."""
STATES = {1: NmtState.OPERATIONAL, 2: NmtState.STOPPED, 128: NmtState.PRE_OPERATIONAL}


def emergency(can_id: int, at: int = 0x0A0) -> list[str]:
    return [f"{at:03X}#508111{can_id & 0xFF:02X}{can_id >> 8:02X}000000"]


any_frame = st.builds(
    Frame,
    st.integers(0, 0x7FF) | st.sampled_from([*sorted(OWN), 0x3A0, 0x190, 0x6C1]),
    st.binary(max_size=8),
    st.booleans() | st.just(False),
)
cob_ids = st.sampled_from(
    [
        (0x1014, 0, [0x0A0, 0x800000A0, 0x080, 0x190]),
        (0x1201, 1, [0x6C0, 0x800006C0, 0x190]),
        (0x1201, 2, [0x6C1, 0x800006C1, 0x190]),
        (0x1400, 1, [0x190, 0x80000190, 0x1A0, 0x800001A0]),
        (0x1800, 1, [0x400001A0, 0x800001A0, 0x190, 0x400006C0]),
        (0x1802, 1, [0x400003A0, 0xC00003A0, 0x080, 0x400001A0]),
    ]
).flatmap(lambda row: st.tuples(st.just(row[:2]), st.sampled_from(row[2])))


def expected_own(dictionary: Dictionary) -> set[int]:
    """The same from the objects alone: valid COB-IDs of what it sends, without those of what it hears."""

    def valid(index: int, subindex: int = 1) -> set[int]:
        value = dictionary.entry(index, subindex).value
        return set() if value & 1 << 31 else {value & 0x7FF}

    second = valid(0x1201, 1) and valid(0x1201, 2)
    sent = valid(0x1014, 0) | {0x5A0} | (valid(0x1201, 2) if second else set())
    for index in range(0x1800, 0x1804):
        sent |= valid(index)
    heard = {0x080, 0x620} | valid(0x1400) | valid(0x1401) | (valid(0x1201, 1) if second else set())
    return sent - heard | {0x720}


@examples(150)
@given(
    changes=st.lists(cob_ids, max_size=8),
    command=st.sampled_from([1, 2, 128]),
    frames=st.lists(any_frame, max_size=30),
    reset=st.sampled_from([129, 130]),
)
def test_whatever_comes_own_can_ids_are_counted_and_the_first_is_told(
    changes: list[tuple[tuple[int, int], int]], command: int, frames: list[Frame], reset: int
) -> None:
    """The state stays, and a reset forgets it."""
    bench = Bench(deepcopy(PRISTINE))
    bench.start()
    for (index, subindex), value in changes:
        bench.write(index, subindex, value, 4)
    bench.nmt(command)
    own = expected_own(bench.dictionary)
    assert bench.node.own_can_ids == own
    first, counted, told = None, 0, list[Frame]()
    for frame in frames:
        if frame.can_id in (0x000, 0x620, 0x7E5, 0x6C0, 0x190):
            continue  # commands, and what may be a request of the second SDO client, change things
        if frame.can_id in own and not frame.rtr:
            counted += 1
            first = frame.can_id if first is None else first
        told += [one for one in bench.node.receive(frame, 0.0) if one.data[:2] == b"\x50\x81"]
        assert bench.node.state is STATES[command]
    assert bench.node.counters.duplicate_frames == counted
    assert bench.application.told("duplicate_received") == ([] if first is None else [(first, 0.0)])
    emcy = bench.dictionary.entry(0x1014).value
    heard = first is not None and command != 2 and not emcy >> 31
    assert hexes(told) == (emergency(first or 0, emcy) if heard else [])
    assert bench.nmt(reset) == ["720#00"]
    assert bench.read(0x1001) == 0
    assert bench.send(0x5A0, bytes(8)) == emergency(0x5A0)
    assert bench.read(0x1003, 1) == 0x5A0 << 16 | 0x8150
