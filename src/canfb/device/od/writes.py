"""Parameters as SDO writes: in which order they can be written, and their concise form (CiA 302-3, 1F22h)."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from canfb.cia301 import cob
from canfb.device.od.dictionary import Entry

_CYCLE_PERIOD, _SYNC, _TIME, _CONSUMERS, _VERIFY = 0x1006, 0x1005, 0x1012, 0x1016, 0x1020
_MAPPINGS = (range(0x1600, 0x1800), range(0x1A00, 0x1C00))
_COMMUNICATIONS = (range(0x1400, 0x1600), range(0x1800, 0x1A00))
_SDO_CHANNELS = range(0x1200, 0x1300)
_EMCY = 0x1014

# What `turn` gives: most parameters, numbers of mapped objects, 1006h, COB-IDs, at last 1020h.
TURNS = range(5)


def turn(entry: Entry) -> int:
    if _is_mapping_count(entry):
        return 1
    if entry.index == _CYCLE_PERIOD:
        return 2
    if entry.index == _VERIFY:
        return 4
    return 3 if _is_cob_id(entry) else 0


def switched_off(entry: Entry, value: Any) -> Any:
    """The value that lets all others be written, for an entry that is going to have `value`; None: it blocks
    no other.

    PDOs, EMCY and further SDO servers not valid, nothing mapped, no SYNC, no TIME, no heartbeat to wait for.
    """
    if _is_mapping_count(entry) or entry.index in (_CYCLE_PERIOD, _CONSUMERS):
        return 0
    if not _is_cob_id(entry):
        return None
    if entry.index == _SYNC:
        return value & ~cob.GENERATE
    # Bit 31 of 1012h means that TIME is consumed; that of all others, that the object does not exist.
    return value & cob.CAN_ID if entry.index == _TIME else cob.NOT_VALID


def _is_cob_id(entry: Entry) -> bool:
    if entry.index in (_SYNC, _TIME, _EMCY):
        return True
    if entry.index in _SDO_CHANNELS:
        return entry.subindex in (1, 2)
    return entry.subindex == 1 and any(entry.index in indices for indices in _COMMUNICATIONS)


def _is_mapping_count(entry: Entry) -> bool:
    return entry.subindex == 0 and any(entry.index in indices for indices in _MAPPINGS)


_COUNT = struct.Struct("<I")
_HEADER = struct.Struct("<HBI")  # index, sub-index, bytes of data


@dataclass(frozen=True, slots=True)
class Write:
    """One SDO write, little-endian."""

    index: int
    subindex: int
    data: bytes


def encode_concise(writes: Iterable[Write]) -> bytes:
    """Their number, then index, sub-index, size and data of each."""
    parts = [_HEADER.pack(one.index, one.subindex, len(one.data)) + one.data for one in writes]
    return _COUNT.pack(len(parts)) + b"".join(parts)


def decode_concise(data: bytes) -> list[Write]:
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
