"""The concise DCF (CiA 302-3, object 1F22h): a list of SDO writes as bytes."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass

_COUNT = struct.Struct("<I")
_HEADER = struct.Struct("<HBI")  # index, sub-index, bytes of data


@dataclass(frozen=True, slots=True)
class Write:
    """One SDO write: the object, and its data as SDO has it, little-endian."""

    index: int
    subindex: int
    data: bytes


def encode_concise(writes: Iterable[Write]) -> bytes:
    """The writes in their order: their number, then index, sub-index, size and data of each."""
    parts = [_HEADER.pack(one.index, one.subindex, len(one.data)) + one.data for one in writes]
    return _COUNT.pack(len(parts)) + b"".join(parts)


def decode_concise(data: bytes) -> list[Write]:
    """The writes of a concise DCF. ValueError for bytes that are none."""
    if len(data) < _COUNT.size:
        raise ValueError("a concise DCF begins with the number of its entries, 4 bytes")
    writes: list[Write] = []
    offset = _COUNT.size
    for number in range(1, _COUNT.unpack_from(data)[0] + 1):
        if offset + _HEADER.size > len(data):
            raise ValueError(f"entry {number} of the concise DCF is truncated")
        index, subindex, size = _HEADER.unpack_from(data, offset)
        offset += _HEADER.size
        if offset + size > len(data):
            raise ValueError(f"entry {number} of the concise DCF, {index:04X}h:{subindex:02X}, is truncated")
        writes.append(Write(index, subindex, data[offset : offset + size]))
        offset += size
    if offset != len(data):
        raise ValueError(f"{len(data) - offset} bytes follow the last entry of the concise DCF")
    return writes
