"""Stored parameters of one group as bytes: versioned, checked, independent of the node-ID."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

FORMAT_VERSION = 1

_MAGIC = b"CANFBPRM"
# Magic, format version, group, a spare byte, vendor-ID, product code, revision number, number of records.
_HEADER = struct.Struct("<8sHBBIIII")
_RECORD = struct.Struct("<HBBI")  # index, sub-index, flags, bytes of data
_CRC = struct.Struct("<I")
_RELATIVE = 0x01


class ParameterGroup(IntEnum):
    """What is saved and restored on its own; the number is the sub-index of 1010h and 1011h.

    LSS is saved by LSS alone (CiA 305), the operating time by the device itself.
    """

    COMMUNICATION = 2
    APPLICATION = 3
    MANUFACTURER = 4
    LSS = 0x80
    OPERATING_TIME = 0x81


class Identity(NamedTuple):
    """Vendor-ID, product code and revision number (1018h)."""

    vendor: int
    product: int
    revision: int

    def accepts(self, other: Identity) -> bool:
        return self[:2] == other[:2] and self.revision >> 16 == other.revision >> 16


@dataclass(frozen=True, order=True, slots=True)
class Record:
    """One entry, little-endian; `relative`: without the node-ID."""

    index: int
    subindex: int
    relative: bool
    data: bytes


class ImageError(ValueError):
    """Stored parameters that cannot be used."""


def encode_image(group: ParameterGroup, identity: Identity, records: Iterable[Record]) -> bytes:
    ordered = sorted(records)
    parts = [_HEADER.pack(_MAGIC, FORMAT_VERSION, group, 0, *identity, len(ordered))]
    for record in ordered:
        flags = _RELATIVE if record.relative else 0
        parts += [_RECORD.pack(record.index, record.subindex, flags, len(record.data)), record.data]
    body = b"".join(parts)
    return body + _CRC.pack(zlib.crc32(body))


def decode_image(data: bytes, group: ParameterGroup, identity: Identity) -> list[Record]:
    """The records of an image, in ascending order.

    ImageError for anything that `encode_image` did not make for this group of this device.
    """
    if len(data) < _HEADER.size + _CRC.size or not data.startswith(_MAGIC):
        raise ImageError("no stored parameters, or truncated")
    body = data[: -_CRC.size]
    if zlib.crc32(body) != _CRC.unpack_from(data, len(body))[0]:
        raise ImageError("the CRC is wrong")
    _, version, its_group, spare, vendor, product, revision, count = _HEADER.unpack_from(body)
    if version != FORMAT_VERSION or spare:
        raise ImageError(f"format version {version}: only {FORMAT_VERSION} is supported")
    if its_group != group:
        raise ImageError(f"the parameters are those of group {its_group}")
    if not identity.accepts(Identity(vendor, product, revision)):
        raise ImageError(
            f"saved by another device: vendor-ID {vendor:X}h, product code {product:X}h, "
            f"revision number {revision:X}h"
        )
    records = _records(body)
    places = [(record.index, record.subindex) for record in records]
    if len(records) != count or places != sorted(set(places)):
        raise ImageError("the records do not match the header")
    return records


def _records(body: bytes) -> list[Record]:
    records: list[Record] = []
    offset = _HEADER.size
    while offset < len(body):
        if offset + _RECORD.size > len(body):
            raise ImageError("the last record is truncated")
        index, subindex, flags, size = _RECORD.unpack_from(body, offset)
        offset += _RECORD.size
        if offset + size > len(body) or flags & ~_RELATIVE:
            raise ImageError(f"the record of {index:04X}h:{subindex:02X} is truncated or has unknown flags")
        records.append(Record(index, subindex, bool(flags & _RELATIVE), body[offset : offset + size]))
        offset += size
    return records
