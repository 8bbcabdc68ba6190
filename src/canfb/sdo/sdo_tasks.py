"""Objects of a node by name, in words: what ``canfb sdo`` reads and writes."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from canfb import objects as od
from canfb.cia301 import datatypes
from canfb.cia301.datatypes import DataType
from canfb.errors import ConfigError
from canfb.marked_yaml import read_bytes
from canfb.master.access import CommissioningError, NodeAccess, RefusedError
from canfb.master.active_table import SAVE_WITHIN_S
from canfb.sdo.object_description import (
    ObjectDescription,
    ObjectDescriptions,
    numbered,
)
from canfb.sdo.object_values import (
    MODULE,
    abort_words,
    from_words,
    in_words,
    parse_value,
    short_real,
    type_name,
    words_of,
)

MOST_BYTES = 32
_PART = re.compile(r"1/(\d+|2\^\d+) (\D.*)")
_COMMUNICATION = range(0x1000, 0x2000)
_SLOW = (0x1010, 0x1011)


@dataclass(frozen=True)
class Reading:
    """An object and its bytes. ``value`` is None where the bytes are not of the type of the EDS."""

    entry: ObjectDescription
    data: bytes
    product: str

    @property
    def value(self) -> Any:
        """By the type of the EDS."""
        try:
            return self.entry.decode(self.data)
        except ValueError:
            return None

    @property
    def words(self) -> str:
        """Bits or enumeration in words, "" for none."""
        return in_words(self.product, self.entry.place, self.value)

    def text(self) -> str:
        """The value for people, with its unit."""
        entry, value = self.entry, self.value
        if value is None:
            return f"{_octets(self.data)} ({len(self.data)} bytes, the EDS has {type_name(entry.data_type)})"
        if isinstance(value, bytes):
            return _octets(value)
        if isinstance(value, str):
            return value
        shown = f"{short_real(value, entry.data_type)}" if isinstance(value, float) else str(value)
        if self._is_number_of_bits:
            shown = f"0x{value:08X}"
        if self.words:
            return f"{shown} ({self.words})"
        part = _PART.fullmatch(entry.unit)
        if part is not None:
            count = 2 ** int(part[1][2:]) if part[1].startswith("2^") else int(part[1])
            return f"{shown} ({value / count:.6g} {part[2]})"
        times = "x " if entry.unit[:1].isdigit() else ""
        return f"{shown} {times}{entry.unit}".rstrip()

    @property
    def _is_number_of_bits(self) -> bool:
        """COB-IDs, mapped objects, CRCs: they are written in hexadecimal."""
        entry = self.entry
        is_plain = entry.data_type == DataType.UNSIGNED32 and not entry.unit
        return is_plain and (entry.index in _COMMUNICATION or "CRC" in entry.name)

    def line(self) -> str:
        """Object and value."""
        return f"{self.entry.number} {self.entry.title}: {self.text()}"

    def figures(self) -> dict[str, Any]:
        """For programs. A value that is no number (NaN) is null."""
        entry, value = self.entry, self.value
        if isinstance(value, bytes):
            value = value.hex()
        elif isinstance(value, float) and not math.isfinite(value):
            value = None
        return {
            "object": entry.number,
            "name": entry.title,
            "type": type_name(entry.data_type),
            "value": value,
            "unit": entry.unit or None,
            "words": self.words or None,
            "bytes": self.data.hex(),
        }


class SdoTasks:
    """Reads and writes of one node, whose objects ``described`` names.

    ConfigError for what is not known or cannot be meant, CommissioningError for what the node refuses.
    """

    def __init__(self, node: NodeAccess, described: ObjectDescriptions) -> None:
        self._node = node
        self._described = described

    def read(self, text: str) -> list[Reading]:
        """What an object holds; all that can be read of a record or an array named as a whole."""
        meant = self._described.meant(text)
        readable = [entry for entry in meant if entry.readable]
        if not readable:
            raise CommissioningError(f"{meant[0].number} {meant[0].title} is write only")
        if len(readable) > 1:
            readable = [entry for entry in readable if entry.subindex or entry.index in _COUNTED]
        return [self._read(entry) for entry in readable]

    def write(self, text: str, value: str | bytes) -> tuple[Reading | None, Reading | None, Reading]:
        """Write a value: what was before and what is there now, None where it cannot be read; the value."""
        entry = self._one(text)
        data = value if isinstance(value, bytes) else self._encoded(entry, value)
        is_domain = entry.data_type == DataType.DOMAIN
        before = self._read(entry) if entry.readable and not is_domain else None
        try:
            if is_domain:
                self._node.download_domain(*entry.place, data)
            else:
                slow = SAVE_WITHIN_S if entry.index in _SLOW else None
                self._node.write_bytes(*entry.place, data, slow)
        except RefusedError as error:
            raise self._refused("writing", entry, error) from None
        now = self._read(entry) if before is not None else None
        return before, now, Reading(entry, data, self._described.product)

    def _one(self, text: str) -> ObjectDescription:
        meant = self._described.meant(text)
        can_be = [one for one in meant if one.writable]
        if len(can_be) == 1:
            return can_be[0]
        if len(meant) > 1:
            several = ", ".join(f"{one.number} {one.name}" for one in can_be)
            raise ConfigError(f"{text!r} has several entries; which one: {several or 'none can be written'}")
        raise CommissioningError(f"{meant[0].number} {meant[0].title} is read only")

    def _encoded(self, entry: ObjectDescription, text: str) -> bytes:
        word = from_words(self._described.product, entry.place, text)
        try:
            value = parse_value(entry.data_type, text, entry.low, entry.high) if word is None else word
        except ValueError as error:
            words = ", ".join(words_of(self._described.product, entry.place))
            hint = f"; or one of the words {words}" if words else ""
            raise ConfigError(f"{entry.number} {entry.title} {error}{hint}") from None
        return value if isinstance(value, bytes) else datatypes.encode(entry.data_type, value)

    def _read(self, entry: ObjectDescription) -> Reading:
        fetch = self._node.upload_domain if entry.data_type == DataType.DOMAIN else self._node.read_bytes
        try:
            return Reading(entry, fetch(*entry.place), self._described.product)
        except RefusedError as error:
            raise self._refused("reading", entry, error) from None

    def _refused(self, doing: str, entry: ObjectDescription, error: RefusedError) -> CommissioningError:
        what = f"{doing} {entry.number} {entry.title}"
        said = abort_words(error.code, entry, self._described.product)
        return CommissioningError(f"{self._node.name}: {what} is refused: {said}")


_COUNTED = frozenset({0x1003, *range(0x1600, 0x1800), *range(0x1A00, 0x1C00)})
"""Objects whose sub-index 0 says more than how many there are."""


def described_by(node: NodeAccess, known: Iterable[Path], text: str) -> ObjectDescriptions:
    """The EDS of the product of a node (1018h), of those ``known``. ConfigError for another product."""
    vendor = node.integer(*od.IDENTITY_VENDOR_ID, "I")
    product = node.integer(*od.IDENTITY_PRODUCT_CODE, "I")
    for path in known:
        if _product(path) == (vendor, product):
            return ObjectDescriptions(path, node.node_id)
    place = numbered(text)
    what = text if place is None else od.place_text((place[0], place[1] or 0))
    raise ConfigError(
        f"{node.name} is product {product} of vendor {vendor}, which is none of ours: give its EDS with "
        f"--eds FILE, so that {what} has a name and a type"
    )


def is_lost(reading: Reading) -> bool:
    """It is the status word of a module, and says that the position is lost."""
    is_status = reading.product == MODULE and reading.entry.place == od.FEEDBACK_STATUS
    return is_status and isinstance(reading.value, int) and bool(reading.value & od.StatusBit.LOST)


def _product(path: Path) -> tuple[int, ...]:
    """VendorNumber and ProductNumber of an EDS, without reading all of it."""
    text = read_bytes(path, CommissioningError).decode("utf-8", errors="replace")
    keys = (re.search(rf"^{key}=(\w+)", text, re.MULTILINE) for key in ("VendorNumber", "ProductNumber"))
    return tuple(int(found[1], 0) for found in keys if found)


def _octets(data: bytes) -> str:
    if len(data) > MOST_BYTES:
        return f"{len(data)} bytes; --out FILE writes them to a file"
    return data.hex(" ") or "empty"
