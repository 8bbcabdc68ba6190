from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.cia301 import datatypes
from canfb.cia301.datatypes import DataType
from canfb.device.od.dictionary import Entry
from canfb.device.pdo.mapping import Slot
from canfb.device.pdo.rpdo import bit_unpacker, length_of, unpacker
from canfb.device.pdo.tpdo import bit_packer, packer

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


@given(mapped())
def test_pack_and_unpack_are_inverse_as_a_struct_and_by_bits(drawn: tuple[list[Slot], list[object]]) -> None:
    slots, values = drawn
    for slot, value in zip(slots, values, strict=True):
        entry_of(slot).value = value
    data = packer(slots)()
    assert data == bit_packer(slots)()
    assert len(data) == length_of(slots) == math.ceil(sum(slot.bits for slot in slots) / 8)
    for unpack in (unpacker(slots), bit_unpacker(slots)):
        for slot in slots:
            entry_of(slot).reset()
        assert unpack(data + b"\xff") == 0
        assert [entry_of(slot).value for slot in slots] == values


@pytest.mark.parametrize("types", [[DataType.UNSIGNED8] * 2, [DataType.BOOLEAN, DataType.UNSIGNED8]])
def test_limits_and_hooks_of_mapped_entries(types: list[DataType]) -> None:
    slots = slots_of(types)
    first, second = (entry_of(slot) for slot in slots)
    second.high = 10
    seen: list[object] = []
    second.on_written = lambda: seen.append(second.value)
    unpack = unpacker(slots)
    bits = slots[0].bits
    assert unpack((1 | 9 << bits).to_bytes(2, "little")) == 0
    assert unpack((0 | 11 << bits).to_bytes(2, "little")) == 1
    assert seen == [9]
    assert (first.value, second.value) == (0, 9)


@pytest.mark.parametrize("types", [[DataType.INTEGER32], [DataType.BOOLEAN, DataType.INTEGER32]])
def test_live_values_are_sampled(types: list[DataType]) -> None:
    slots = slots_of(types)
    entry_of(slots[-1]).on_read = lambda: -1
    data = ((1 << 32) - 1 << 32 - 32 + (slots[0].bits & 1)).to_bytes(length_of(slots), "little")
    assert packer(slots)() == data


@pytest.mark.parametrize(
    ("kind", "value"),
    [*((DataType.UNSIGNED16, value) for value in (70000, -1, 1.5, "text", None)), (DataType.REAL32, 1e39)],
)
def test_a_value_that_does_not_fit_is_named(kind: DataType, value: object) -> None:
    slots = slots_of([DataType.UNSIGNED8, kind])
    entry_of(slots[1]).value = value
    with pytest.raises(ValueError, match="2000h:02"):
        packer(slots)()
