"""Mapped data as bytes; and parameters of a PDO, which go in any order while it is not valid."""

import math
from functools import partial
from operator import getitem

import pytest
from device_kit import ID, OK, Bench
from hypothesis import given, strategies as st

from canfb.cia301 import cob, datatypes
from canfb.cia301.codes import AbortCode
from canfb.cia301.datatypes import DataType
from canfb.device.od.dictionary import Dictionary, Entry
from canfb.device.pdo.mapping import Slot
from canfb.device.pdo.rpdo import bit_unpacker, length_of, unpacker
from canfb.device.pdo.tpdo import bit_packer, packer
from canfb.eds_files import eds_path
from folding import each

MAPPABLE = [code for code in DataType if datatypes.bit_length(code)]


def slots_of(types: list[DataType]) -> list[Slot]:
    entries = [Entry(0x2000, sub, code, pdo_mappable=True) for sub, code in enumerate(types, 1)]
    return [Slot(entry, entry.data_type, entry.bit_length) for entry in entries]


def entry_of(slot: Slot) -> Entry:
    assert slot.entry is not None
    return slot.entry


def values_of(code: DataType) -> st.SearchStrategy[object]:
    if code is DataType.BOOLEAN:
        return st.booleans()
    if code in datatypes.FLOATS:
        return st.floats(width=32, allow_nan=False)
    if code in datatypes.BYTES:
        return st.binary(min_size=6, max_size=6)
    bits = datatypes.bit_length(code)
    if code in datatypes.SIGNED_BITS:
        return st.integers(-(1 << (bits - 1)), (1 << (bits - 1)) - 1)
    return st.integers(0, (1 << bits) - 1)


@st.composite
def mapped(draw: st.DrawFn) -> tuple[list[Slot], list[object]]:
    types = draw(st.lists(st.sampled_from(MAPPABLE), min_size=1, max_size=8))
    while sum(datatypes.bit_length(code) for code in types) > 64:
        types.pop()
    return slots_of(types), [draw(values_of(code)) for code in types]


@given(mapped(), st.integers(0, 7))
def test_pack_and_unpack_are_inverse_as_a_struct_and_by_bits(
    drawn: tuple[list[Slot], list[object]], live: int
) -> None:
    """One of the values may be live."""
    slots, values = drawn
    for slot, value in zip(slots, values, strict=True):
        entry_of(slot).value = value
    if live < len(slots):
        entry_of(slots[live]).on_read = partial(getitem, values, live)
        entry_of(slots[live]).reset()
    data = packer(slots)()
    assert data == bit_packer(slots)()
    assert len(data) == length_of(slots) == math.ceil(sum(slot.bits for slot in slots) / 8)
    for unpack in (unpacker(slots), bit_unpacker(slots)):
        for slot in slots:
            entry_of(slot).reset()
        assert unpack(data + b"\xff") == 0
        assert [entry_of(slot).value for slot in slots] == values


@each("kind, value", [
    *((DataType.UNSIGNED16, value) for value in (70000, -1, 1.5, "text", None)), (DataType.REAL32, 1e39),
])  # fmt: skip
def test_a_value_that_does_not_fit_is_named(kind: DataType, value: object) -> None:
    slots = slots_of([DataType.UNSIGNED8, kind])
    entry_of(slots[1]).value = value
    with pytest.raises(ValueError, match="2000h:02"):
        packer(slots)()


DICTIONARY = Dictionary.load(eds_path("canfb-module"), ID)
SIZES = {1: 4, 2: 1, 3: 2, 5: 2, 6: 1}
RECEIVED, SENT = (0x1400, 0x1401), (0x1800, 0x1801, 0x1802, 0x1803)
REMOTE_ONLY = (0xFC, 0xFD)
NO_RTR, FREE = cob.NO_RTR, cob.NOT_VALID
CAN_IDS = st.integers(0, 0x7FF).filter(lambda can_id: not cob.is_restricted(can_id))
State = dict[int, int]


def is_legal(state: State) -> bool:
    """Whether a valid PDO may be as it is."""
    return not (state[2] in REMOTE_ONLY and state[1] & NO_RTR)


@st.composite
def states(draw: st.DrawFn, index: int) -> State:
    """Communication parameters, each good by itself; the COB-ID as that of a valid PDO."""
    remote = REMOTE_ONLY if index in SENT else ()
    kinds = st.one_of(st.integers(0, 240), st.sampled_from([254, 255, *remote, *remote]))
    values = {
        1: draw(CAN_IDS) | draw(st.sampled_from([0, NO_RTR])),
        2: draw(kinds),
        3: draw(st.integers(0, 0xFFFF)),
        5: draw(st.integers(0, 0xFFFF)),
        6: draw(st.integers(0, 240)),
    }
    return {sub: value for sub, value in values.items() if (index, sub) in DICTIONARY}


@st.composite
def programs(draw: st.DrawFn) -> tuple[int, State, list[tuple[int, int]]]:
    """A PDO, its last state, and writes that lead there by way of any others while it is not valid."""
    index = draw(st.sampled_from([*RECEIVED, *SENT]))
    last = draw(states(index))
    detours = [
        (sub, value) for state in draw(st.lists(states(index), max_size=3)) for sub, value in state.items()
    ]
    before = draw(st.permutations(detours))
    arrival = draw(st.permutations(list(last.items())))
    return index, last, [(sub, value | FREE if sub == 1 else value) for sub, value in [*before, *arrival]]


BENCH = Bench(DICTIONARY)
BENCH.start()


def as_delivered() -> Bench:
    """One node for all examples, reset: to read an EDS takes longer than an example."""
    BENCH.nmt(129)
    return BENCH


@given(programs())
def test_any_order_leads_to_any_state(program: tuple[int, State, list[tuple[int, int]]]) -> None:
    index, last, writes = program
    bench = as_delivered()
    assert bench.write(index, 1, bench.read(index, 1) | FREE, 4) == OK
    assert {bench.write(index, sub, value, SIZES[sub]) for sub, value in writes} == {OK}
    state = {sub: bench.read(index, sub) for sub in SIZES if (index, sub) in bench.dictionary}
    assert state == last | {1: last[1] | FREE}
    answer = bench.write(index, 1, last[1], 4)
    assert answer == (OK if is_legal(last) else AbortCode.INVALID_VALUE)
    assert bench.read(index, 1) == (last[1] if is_legal(last) else last[1] | FREE)


COB_IDS = [(0x1005, 0), (0x1012, 0), (0x1014, 0), (0x1201, 1), (0x1201, 2)]
COB_IDS += [(index, 1) for index in (*RECEIVED, *SENT)]


@each("place", COB_IDS)
@each("bits", [1 << 29, 1 << 11, 1 << 28, 0x1FFFF800])
def test_frames_of_29_bits_are_refused_whether_it_is_valid_or_not(place: tuple[int, int], bits: int) -> None:
    bench = as_delivered()
    value = bench.read(*place)
    for switch in (0, FREE):
        assert bench.write(*place, value | bits | switch, 4) is AbortCode.INVALID_VALUE
    assert bench.read(*place) == value
