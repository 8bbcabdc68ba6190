"""PDO mapping (CiA 301, 7.5.2.36): from mapping entries to a compiled packer."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from enum import Enum
from typing import Any, NamedTuple, Protocol

from canfb.cia301 import datatypes
from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.cia301.datatypes import DataType
from canfb.cia301.pdo_room import LONGEST_BITS as LONGEST_BITS
from canfb.device.od.dictionary import Dictionary
from canfb.device.od.entry import RPDO_ACCESS, TPDO_ACCESS, Entry

UNFIT = (struct.error, OverflowError)
"""What `struct` raises for a value that does not fit."""


class Direction(Enum):
    """Whether the device receives or transmits the PDO."""

    RECEIVE = "RPDO"
    TRANSMIT = "TPDO"


ACCESS = {Direction.RECEIVE: RPDO_ACCESS, Direction.TRANSMIT: TPDO_ACCESS}


class Slot(NamedTuple):
    """One mapped object: its entry (None for a dummy), data type and length in bits."""

    entry: Entry | None
    data_type: int
    bits: int


def resolve(dictionary: Dictionary, mapping: int, direction: Direction) -> Slot:
    """What a mapping entry (index, sub-index, bits) names.

    SdoAbort 06020000h when there is no such object, 06040041h when it cannot be mapped in this
    direction or with this length.
    """
    index, subindex, bits = mapping >> 16, mapping >> 8 & 0xFF, mapping & 0xFF
    if index in dictionary.dummies and direction is Direction.RECEIVE:
        if subindex or bits != datatypes.bit_length(index):
            raise SdoAbort(AbortCode.NOT_MAPPABLE)
        return Slot(None, index, bits)
    entry = dictionary.find(index, subindex)
    if entry is None:
        raise SdoAbort(AbortCode.NO_OBJECT)
    allowed = entry.pdo_mappable and entry.access in ACCESS[direction]
    if not allowed or not bits or bits != entry.bit_length:
        raise SdoAbort(AbortCode.NOT_MAPPABLE)
    return Slot(entry, entry.data_type, bits)


def resolve_all(dictionary: Dictionary, mappings: Sequence[int], direction: Direction) -> list[Slot]:
    """All objects of a PDO. SdoAbort 06040042h when they are longer than a frame."""
    slots = [resolve(dictionary, mapping, direction) for mapping in mappings]
    if sum(slot.bits for slot in slots) > LONGEST_BITS:
        raise SdoAbort(AbortCode.PDO_LENGTH)
    return slots


class Layout(Protocol):
    """A compiled mapping: `length` is that of the PDO in bytes.

    `pack()` gives the data of the PDO from the current values; ValueError when one does not fit its
    type. `unpack(data)` puts data of at least `length` bytes into the dictionary, and gives the number
    of values that were refused.
    """

    length: int

    @property
    def pack(self) -> Callable[[], bytes]:
        """Packs the current values."""

    @property
    def unpack(self) -> Callable[[bytes], int]:
        """Stores the values."""


def compile_layout(slots: Sequence[Slot]) -> Layout:
    """The fastest packer for the mapping. Hooks of the entries are looked at now, not later."""
    if all(_is_aligned(slot) for slot in slots):
        return AlignedLayout(slots)
    return BitLayout(slots)


class AlignedLayout:
    """Whole bytes of types that `struct` knows."""

    __slots__ = ("length", "pack", "unpack")

    def __init__(self, slots: Sequence[Slot]) -> None:
        packer = struct.Struct("<" + "".join(_letter(slot) for slot in slots))
        self.length = packer.size
        entries = tuple(slot.entry for slot in slots if slot.entry is not None)
        self.pack = _packer(packer.pack, entries)
        self.unpack = _unpacker(packer.unpack_from, entries)


class BitLayout:
    """Any lengths, one after the other without gaps, least significant bit first."""

    __slots__ = ("_places", "length")

    def __init__(self, slots: Sequence[Slot]) -> None:
        self._places: list[tuple[int, Slot]] = []
        offset = 0
        for slot in slots:
            self._places.append((offset, slot))
            offset += slot.bits
        self.length = (offset + 7) // 8

    def pack(self) -> bytes:
        """Data of the PDO; bits beyond the mapping are 0."""
        word = 0
        for offset, slot in self._places:
            if slot.entry is not None:
                word |= int.from_bytes(slot.entry.encode(), "little") << offset
        return word.to_bytes(self.length, "little")

    def unpack(self, data: bytes) -> int:
        """Data into the dictionary."""
        word = int.from_bytes(data, "little")
        refused = 0
        for offset, slot in self._places:
            if slot.entry is not None:
                bits = word >> offset & (1 << slot.bits) - 1
                raw = bits.to_bytes((slot.bits + 7) // 8, "little")
                refused += not _store(slot.entry, datatypes.decode(slot.data_type, raw))
        return refused


def _packer(pack: Callable[..., bytes], entries: tuple[Entry, ...]) -> Callable[[], bytes]:
    """Packs the current values. For a few entries without a list, which takes longer than to pack."""
    if any(entry.on_read for entry in entries) or len(entries) not in (1, 2, 3):
        return _packer_of_any(pack, entries)
    first, second, third = (entries * 3)[:3]

    def pack_one() -> bytes:
        try:
            return pack(first.value)
        except UNFIT:
            raise _unfit(entries) from None

    def pack_two() -> bytes:
        try:
            return pack(first.value, second.value)
        except UNFIT:
            raise _unfit(entries) from None

    def pack_three() -> bytes:
        try:
            return pack(first.value, second.value, third.value)
        except UNFIT:
            raise _unfit(entries) from None

    return (pack_one, pack_two, pack_three)[len(entries) - 1]


def _packer_of_any(pack: Callable[..., bytes], entries: tuple[Entry, ...]) -> Callable[[], bytes]:
    def pack_any() -> bytes:
        try:
            return pack(*[entry.current() for entry in entries])
        except UNFIT:
            raise _unfit(entries) from None

    return pack_any


def _unfit(entries: tuple[Entry, ...]) -> ValueError:
    """The error that names the entry whose value does not fit."""
    for entry in entries:
        try:
            entry.encode()
        except ValueError as error:
            return error
    return ValueError(f"the values of {entries} do not fit their types")


def _unpacker(
    unpack: Callable[[bytes], tuple[Any, ...]], entries: tuple[Entry, ...]
) -> Callable[[bytes], int]:
    """Stores the values. Two or three without limits and hooks, a sample, without a loop."""

    def unpack_any(data: bytes) -> int:
        return sum(not _store(entry, value) for entry, value in zip(entries, unpack(data), strict=True))

    def unpack_plain(data: bytes) -> int:
        for entry, value in zip(entries, unpack(data), strict=True):
            entry.value = value
        return 0

    if not all(_is_plain(entry) for entry in entries):
        return unpack_any
    if len(entries) not in (2, 3):
        return unpack_plain
    first, second, third = (entries * 2)[:3]

    def unpack_two(data: bytes) -> int:
        first.value, second.value = unpack(data)
        return 0

    def unpack_three(data: bytes) -> int:
        first.value, second.value, third.value = unpack(data)
        return 0

    return unpack_two if len(entries) == 2 else unpack_three


def _is_aligned(slot: Slot) -> bool:
    return slot.data_type != DataType.BOOLEAN and slot.data_type in datatypes.FORMATS


def _letter(slot: Slot) -> str:
    return datatypes.FORMATS[slot.data_type] if slot.entry is not None else f"{slot.bits // 8}x"


def _is_plain(entry: Entry) -> bool:
    no_limits = entry.low is None and entry.high is None
    return no_limits and entry.on_check is None and entry.on_written is None


def _store(entry: Entry, value: Any) -> bool:
    try:
        entry.store(value)
    except SdoAbort:
        return False
    return True
