"""An EDS file taken apart: sections, objects, entries, numbers and data types (CiA 306).

What is missing, or is not a number where one is expected, is None.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

from canfb.device.od.eds import parse

DOMAIN, VAR, ARRAY, RECORD = 0x2, 0x7, 0x8, 0x9
"""Object types."""
U8, U16, U32, VISIBLE_STRING, DOMAIN_TYPE = 0x05, 0x06, 0x07, 0x09, 0x0F
"""Data types, as far as the checks name them."""

_SIGNED_BITS = {0x02: 8, 0x03: 16, 0x04: 32, 0x10: 24, 0x12: 40, 0x13: 48, 0x14: 56, 0x15: 64}
_UNSIGNED_BITS = {0x01: 1, 0x05: 8, 0x06: 16, 0x07: 32, 0x16: 24, 0x18: 40, 0x19: 48, 0x1A: 56, 0x1B: 64}
_REAL_BITS = {0x08: 32, 0x11: 64}
BITS = _SIGNED_BITS | _UNSIGNED_BITS | _REAL_BITS
"""Length of each data type that is a number, bits: these are the ones that a PDO can carry."""
UNSIZED_TYPES = {0x09: "VISIBLE_STRING", 0x0A: "OCTET_STRING", 0x0B: "UNICODE_STRING", 0x0F: "DOMAIN"}

_NUMBER = re.compile(r"-?(0x[0-9a-f]+|0|[1-9][0-9]*)", re.IGNORECASE)
_NODE_ID = re.compile(r"\$NODEID(?:\+(?P<number>[^+]+))?", re.IGNORECASE)
_OBJECT_SECTION = re.compile(r"(?P<index>[0-9a-f]{4})(?:sub(?P<sub>0|[1-9a-f][0-9a-f]?))?")


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, in one section."""

    section: str
    text: str


@dataclass
class Section:
    """One section of the file; keys are in lower case, since CiA 306 does not tell case apart."""

    name: str
    values: dict[str, str] = field(default_factory=dict)

    def text(self, key: str) -> str | None:
        """Value of a key; None if it is missing or empty, which mean the same in CiA 306."""
        return self.values.get(key.lower()) or None

    def number(self, key: str) -> int | None:
        """Value of a key as a plain number; None if it is missing or none."""
        return number(self.text(key))

    @property
    def object_type(self) -> int:
        """Object type; a missing one means VAR (CiA 306)."""
        given = self.number("ObjectType")
        return VAR if given is None else given


@dataclass(frozen=True)
class Entry:
    """What SDO reads and writes: a VAR or DOMAIN, or one sub-index of an ARRAY or RECORD."""

    index: int
    sub: int
    section: Section

    @property
    def data_type(self) -> int:
        """Index of the data type, 0 if it is missing."""
        return self.section.number("DataType") or 0

    @property
    def access(self) -> str:
        """Access type in lower case, empty if it is missing."""
        return (self.section.text("AccessType") or "").lower()

    @property
    def mappable(self) -> bool:
        """Whether a PDO may carry it."""
        return self.section.number("PDOMapping") == 1

    def default(self, node_id: int) -> int | None:
        """Default of an integer entry at this node-ID; None if there is none."""
        return number(self.section.text("DefaultValue"), node_id)


@dataclass
class Eds:
    """The whole file. COB-IDs are looked at as they are at `node_id`."""

    file_name: str
    node_id: int
    text: str
    sections: dict[str, Section] = field(default_factory=dict)
    objects: dict[int, Section] = field(default_factory=dict)
    entries: dict[tuple[int, int], Entry] = field(default_factory=dict)

    def section(self, name: str) -> Section:
        """The section of this name; an empty one if it is missing."""
        return self.sections.get(name.lower()) or Section(name)

    def subs(self, index: int) -> dict[int, Entry]:
        """The entries of one ARRAY or RECORD by sub-index; nothing for other objects."""
        whole = self.objects.get(index)
        return {
            sub: entry
            for (owner, sub), entry in self.entries.items()
            if owner == index and entry.section is not whole
        }


def read(text: str, file_name: str, node_id: int) -> Eds:
    """Take a file apart with the reader of the package. ValueError when it is not an EDS."""
    parser = parse(text.encode("utf-8"))
    eds = Eds(file_name, node_id, text)
    for name in parser.sections():
        values = {key.lower(): value.strip() for key, value in parser.items(name)}
        eds.sections[name.lower()] = Section(name, values)
    _find_objects(eds)
    return eds


def _find_objects(eds: Eds) -> None:
    for name, section in eds.sections.items():
        place = object_place(name)
        if place is None:
            continue
        index, sub = place
        if sub is None:
            eds.objects[index] = section
        if sub is not None or section.object_type not in (ARRAY, RECORD):
            eds.entries[index, sub or 0] = Entry(index, sub or 0, section)


def object_place(name: str) -> tuple[int, int | None] | None:
    """Index and sub-index that a section is named for; no sub-index for a whole object."""
    match = _OBJECT_SECTION.fullmatch(name.lower())
    if match is None:
        return None
    return int(match["index"], 16), None if match["sub"] is None else int(match["sub"], 16)


def number(text: str | None, node_id: int | None = None) -> int | None:
    """Value of a decimal or hexadecimal number, also of `$NODEID+number` where a node-ID is given.

    None if it is none. A leading zero would mean octal (CiA 306): refused, since nobody expects it. $NODEID
    comes first: behind a number it would be plain text (CiA 306).
    """
    compact = (text or "").replace(" ", "")
    if _NUMBER.fullmatch(compact):
        return int(compact, 0)
    match = _NODE_ID.fullmatch(compact)
    if match is None or node_id is None:
        return None
    offset = number(match["number"] or "0")
    return None if offset is None else node_id + offset


def number_of_type(text: str, data_type: int, node_id: int | None = None) -> float | None:
    """Value of a number of this data type; REAL types are written as decimal numbers. None if it is none."""
    if data_type not in _REAL_BITS:
        return number(text, node_id)
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def is_communication(index: int) -> bool:
    """Whether the object holds the communication parameter of a PDO."""
    return 0x1400 <= index < 0x1600 or 0x1800 <= index < 0x1A00


def is_mapping(index: int) -> bool:
    """Whether the object holds the mapping parameter of a PDO."""
    return 0x1600 <= index < 0x1800 or 0x1A00 <= index < 0x1C00
