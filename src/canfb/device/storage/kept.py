"""Stored parameters: which entries they are, which values are saved, and how they are restored.

The image of a group, its values as bytes, has a version and a CRC and is independent of the node-ID.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

from canfb.cia301 import datatypes
from canfb.cia301.codes import SdoAbort
from canfb.device.od.dcf import TURNS, switched_off, turn
from canfb.device.od.dictionary import WRITABLE, Dictionary, Entry, is_accepted

FORMAT_VERSION = 1

_MAGIC = b"CANFBPRM"
# Magic, format version, group, a spare byte, vendor-ID, product code, revision number, number of records.
_HEADER = struct.Struct("<8sHBBIIII")
_RECORD = struct.Struct("<HBBI")  # index, sub-index, flags, bytes of data
_CRC = struct.Struct("<I")
_RELATIVE = 0x01


class ParameterGroup(IntEnum):
    """A group is saved and restored as a whole; its number is the sub-index of 1010h and 1011h.

    Only LSS saves LSS (CiA 305), only the device the operating time.
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
    """One entry; `data` is little-endian, `relative`: less the node-ID."""

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

    ImageError unless `encode_image` made it for this group of this device.
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


# The indices of each group (CiA 301, 7.5.2.13); together without gaps.
RANGES = {
    ParameterGroup.COMMUNICATION: range(0x1000, 0x2000),
    ParameterGroup.MANUFACTURER: range(0x2000, 0x6000),
    ParameterGroup.APPLICATION: range(0x6000, 0xA000),
}
PARAMETER_INDICES = range(0x1000, 0xA000)

# Objects with access rw that are commands, not parameters.
NO_PARAMETERS = frozenset({0x1003, 0x1010, 0x1011})

_CAN_ID = 0x1FFFFFFF
_FLAGS_AND_ID = 0xFFFFFFFF


class KeptEntries:
    """The stored parameters of a device: entries with access rw, unless `leave_out` says otherwise; `keep`
    adds others.

    `written()` is called after each SDO write to one.
    """

    def __init__(self, dictionary: Dictionary, written: Callable[[], None]) -> None:
        self._dictionary = dictionary
        self._written = written
        self._saved_value: dict[tuple[int, int], Callable[[], Any]] = {}
        self._added: set[tuple[int, int]] = set()
        self._entries = {
            (entry.index, entry.subindex): entry
            for entry in dictionary
            if entry.access == "rw" and entry.index not in NO_PARAMETERS and entry.index in PARAMETER_INDICES
        }
        for entry in self._entries.values():
            entry.on_download = written

    def leave_out(self, index: int, subindex: int = 0) -> None:
        """Do not store this entry. KeyError without it."""
        self._entries.pop((index, subindex), None)
        self._dictionary.entry(index, subindex).on_download = None

    def keep(self, index: int, subindex: int = 0, *, saved: Callable[[], Any] | None = None) -> None:
        """Store this entry; the value is ``saved()`` if given. KeyError without it."""
        place = index, subindex
        self._entries[place] = entry = self._dictionary.entry(*place)
        self._added.add(place)
        if saved is not None:
            self._saved_value[place] = saved
        if entry.access in WRITABLE:
            entry.on_download = self._written

    def save_as(self, index: int, subindex: int, saved: Callable[[], Any]) -> None:
        """Store ``saved()`` instead of the present value of this parameter."""
        self._saved_value[index, subindex] = saved

    def of(self, group: ParameterGroup) -> list[Entry]:
        return [entry for place, entry in sorted(self._entries.items()) if place[0] in RANGES[group]]

    def settings(self) -> list[Entry]:
        return [entry for place, entry in sorted(self._entries.items()) if place not in self._added]

    def records(self, group: ParameterGroup, node_id: int) -> list[Record]:
        saved = {place: value() for place, value in self._saved_value.items()}
        values = ((entry, saved.get((entry.index, entry.subindex), entry.value)) for entry in self.of(group))
        return [
            _record(entry, value, node_id)
            for entry, value in values
            if is_accepted(entry.check_limits, value)
        ]


def _record(entry: Entry, value: Any, node_id: int) -> Record:
    relative = has_default_can_id(entry, value)
    if relative:
        value = (value - node_id) & _FLAGS_AND_ID
    return Record(entry.index, entry.subindex, relative, datatypes.encode(entry.data_type, value))


def restored_value(entry: Entry, record: Record, node_id: int) -> Any:
    if not record.relative:
        return entry.decode(record.data)
    value = (int.from_bytes(record.data, "little") + node_id) & _FLAGS_AND_ID
    return entry.decode(value.to_bytes(len(record.data), "little"))


def has_default_can_id(entry: Entry, value: Any) -> bool:
    """Whether a COB-ID follows the node-ID: its CAN-ID is the default."""
    can_follow = entry.follows_node_id and entry.byte_length == 4
    return can_follow and not (int(value) ^ int(entry.default)) & _CAN_ID


Value = tuple[Entry, Any]


def restore(entries: KeptEntries, group: ParameterGroup, records: list[Record], node_id: int) -> None:
    """Write all records, or none and raise ImageError.

    Each value passes the checks of an SDO write, in the order that CiA 301 requires: everything is switched
    off first, mappings, periods and COB-IDs come last. No `on_written` runs: the services read their
    parameters after a reset.
    """
    before = [(entry, entry.value) for entry in entries.of(group)]
    try:
        values = _values(entries, group, records, node_id)
        for entry, value in values:
            off = switched_off(entry, value)
            if off is not None:
                entry.value = off
        _write(values)
    except ImageError:
        for entry, value in before:
            entry.value = value
        raise


def _values(entries: KeptEntries, group: ParameterGroup, records: list[Record], node_id: int) -> list[Value]:
    values: list[Value] = []
    known = {(entry.index, entry.subindex): entry for entry in entries.of(group)}
    for record in records:
        where = f"{record.index:04X}h:{record.subindex:02X}"
        entry = known.get((record.index, record.subindex))
        if entry is None:
            raise ImageError(f"{where} is not a parameter of this device")
        try:
            values.append((entry, restored_value(entry, record, node_id)))
        except SdoAbort as abort:
            raise ImageError(f"{where}: {abort}") from None
    return values


def _write(values: list[Value]) -> None:
    """Write turn by turn; retry values that depend on another, such as a lower limit on the upper one."""
    for this in TURNS:
        waiting = [value for value in values if turn(value[0]) == this]
        while waiting:
            refused = [(value, reason) for value in waiting if (reason := _refusal(*value))]
            if len(refused) == len(waiting):
                raise ImageError(refused[0][1])
            waiting = [value for value, _ in refused]


def _refusal(entry: Entry, value: Any) -> str:
    try:
        entry.check(value)
    except SdoAbort as abort:
        return f"{entry.index:04X}h:{entry.subindex:02X}: {abort}"
    entry.value = value
    return ""
