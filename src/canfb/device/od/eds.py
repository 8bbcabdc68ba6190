"""EDS and DCF files (CiA 306): one reader, for the device and for the tools.

Tolerant of oddities that change no value (byte order mark, Ctrl-Z, Windows-1252, indented lines, case, octal
numbers, empty ones); strict about values: a bad data type, access, default or limit is refused, with its
section and key. The same content is parsed once in a process.
"""

from __future__ import annotations

import math
import re
from configparser import Error as ParserError, RawConfigParser
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import Any

from canfb.cia301 import datatypes
from canfb.cia301.datatypes import DataType
from canfb.errors import saying
from canfb.files import decoded

Contents = dict[str, dict[str, str]]  # The keys of a file and their texts, by section.


class ObjectKind(IntEnum):
    """Object code (CiA 301, 7.4.3)."""

    NULL = 0x00
    DOMAIN = 0x02
    DEFTYPE = 0x05
    DEFSTRUCT = 0x06
    VAR = 0x07
    ARRAY = 0x08
    RECORD = 0x09


@dataclass(frozen=True, slots=True)
class Description:
    """One entry as the file describes it; `default`, `low` and `high` are texts until a node-ID is known.

    `parent` is the name of the object, empty if it has no sub-indices. `unit` is from a key Unit, or from a
    comment `;Unit=` above the section.
    """

    index: int
    subindex: int
    name: str
    parent: str
    data_type: int
    access: str
    pdo_mappable: bool
    unit: str
    section: str
    default: str
    low: str
    high: str

    @property
    def follows_node_id(self) -> bool:
        return "$NODEID" in self.default.upper()

    def limits(self, node_id: int) -> tuple[Any, Any]:
        """Lowest and highest value; None for none. ValueError that names section and key."""
        if self.data_type in _WITHOUT_LIMITS:
            return None, None
        return self.value_of("LowLimit", self.low, node_id), self.value_of("HighLimit", self.high, node_id)

    def value_of(self, key: str, text: str, node_id: int) -> Any:
        try:  # runs a thousand times at each start: a context manager would be slow
            return number(text, self.data_type, node_id)
        except ValueError as error:
            raise ValueError(f"[{self.section}] {key}: {error}") from None


@dataclass(frozen=True, slots=True)
class Described:
    """A whole file. `vendor` and `product` are the numbers of 1018h, None where the file has none."""

    product_name: str
    vendor: int | None
    product: int | None
    objects: tuple[int, ...]  # Indices in ascending order; an object may have no entries.
    entries: tuple[Description, ...]
    dummies: frozenset[int]  # Data types that may fill gaps of an RPDO (section DummyUsage).


ACCESS = frozenset({"ro", "rw", "wo", "rwr", "rww", "const"})
FIRST_OBJECT = 0x1000  # Lower indices are data types (CiA 301, 7.4.1), not objects of the device.
LONGEST_MESSAGE = 200
# Data types that a profile or a manufacturer defines: their values are bytes here.
_FIRST_OWN_TYPE, _LAST_OWN_TYPE = 0x20, 0x025F
_WITHOUT_LIMITS = datatypes.STRINGS | datatypes.BYTES
_INDEX = re.compile(r"^[0-9A-Fa-f]{4}$")
_SUBINDEX = re.compile(r"^([0-9A-Fa-f]{4})sub(0*[0-9A-Fa-f]{1,2})$", re.IGNORECASE)
_LIST = re.compile(r"^([0-9A-Fa-f]{4})(Name|Value)$", re.IGNORECASE)
_DUMMY = re.compile(r"^Dummy([0-9A-Fa-f]{4})$", re.IGNORECASE)
_HEADER = re.compile(r"^\[([^\]\n]*)\]", re.MULTILINE)
_UNIT = re.compile(r"^; *Unit *=(.*)\n\[([^\]\n]*)\]", re.MULTILINE)
_OCTAL = re.compile(r"[+-]?0[0-9]+")
# The keys that the sub-indices of CompactSubObj inherit from their object.
_SHARED = frozenset({"DataType", "AccessType", "PDOMapping", "LowLimit", "HighLimit", "DefaultValue"})
# Sections and keys as CiA 306 spells them; case has no meaning in a file.
_SPELLING = {
    name.lower(): name
    for name in (
        *("FileInfo", "DeviceInfo", "DummyUsage", "Comments", "DeviceComissioning", "MandatoryObjects"),
        *("OptionalObjects", "ManufacturerObjects", "ParameterName", "ObjectType", "DataType", "AccessType"),
        *("DefaultValue", "LowLimit", "HighLimit", "PDOMapping", "SubNumber", "CompactSubObj", "ObjFlags"),
        *("ParameterValue", "Unit", "VendorNumber", "ProductNumber", "ProductName", "EDSVersion"),
    )
}


def read(path: Path) -> Contents:
    """The sections of the file, as of `parse`. OSError; ValueError if it is not an EDS."""
    with saying(ValueError, str(path), ValueError):
        return parse(path.read_bytes())


def parse(content: bytes) -> Contents:
    """The sections of a file with this content: usual spelling, CompactSubObj written out, a type for DOMAIN.

    ValueError when it is not an EDS.
    """
    parser = RawConfigParser(delimiters=("=",), inline_comment_prefixes=(";",))
    parser.optionxform = _spelled  # type: ignore[assignment,method-assign]
    text = _HEADER.sub(lambda match: f"[{_section_name(match[1])}]", _text(content))
    try:
        parser.read_string(text, source="the file")
    except ParserError as error:
        said = " ".join(str(error).split())[:LONGEST_MESSAGE]  # the message lists every bad line
        raise ValueError(f"not an EDS: {said}") from error
    contents = {name: dict(parser.items(name)) for name in parser.sections()}
    for section in filter(_INDEX.match, parser.sections()):
        _expand_compact(contents, section)
    for section, options in contents.items():
        if _kind(contents, section) is ObjectKind.DOMAIN:
            for option, text in (("DataType", f"0x{DataType.DOMAIN:04X}"), ("AccessType", "rw")):
                options[option] = options.get(option) or text
    return contents


def _text(content: bytes) -> str:
    """Lines stripped of blanks: an indented line would continue the previous one."""
    text, _, _ = decoded(content).partition("\x1a")  # Ctrl-Z, the end-of-file mark of DOS
    return "\n".join(line.strip() for line in re.split(r"\r\n?|\n", text))


def _spelled(name: str) -> str:
    return _SPELLING.get(name.strip().lower(), name.strip())


def _section_name(name: str) -> str:
    name = _spelled(name)
    if _INDEX.match(name):
        return name.upper()
    if match := _SUBINDEX.match(name):
        return f"{match[1].upper()}sub{int(match[2], 16):X}"
    if match := _LIST.match(name):
        return f"{match[1].upper()}{match[2].capitalize()}"
    return name


def sections(contents: Contents) -> dict[tuple[int, int], str]:
    """Name of the section that describes each entry, by index and sub-index.

    For sub-index 0 of an object with sub-indices, it is ``[1018sub0]`` rather than ``[1018]``.
    """
    found: dict[tuple[int, int], str] = {}
    for name in contents:
        if _INDEX.match(name):
            found.setdefault((int(name, 16), 0), name)
        elif match := _SUBINDEX.match(name):
            found[int(match[1], 16), int(match[2], 16)] = name
    return found


@lru_cache(maxsize=8)
def content_described(content: bytes) -> Described:
    """Parse the content of an EDS file. ValueError with section and key for invalid values."""
    contents = parse(content)
    units = {_section_name(match[2]): match[1].strip() for match in _UNIT.finditer(_text(content))}
    places = sections(contents)
    objects, entries = [], []
    own = sorted(place for place in places if place[0] >= FIRST_OBJECT)
    for index, of_object in groupby(own, lambda place: place[0]):
        head = f"{index:04X}"
        kind = _kind(contents, head) if head in contents else ObjectKind.RECORD
        if kind is ObjectKind.NULL:
            continue
        subs = [sub for _, sub in of_object if places[index, sub] != head]
        has_subs = bool(subs) or kind in (ObjectKind.ARRAY, ObjectKind.RECORD, ObjectKind.DEFSTRUCT)
        name = contents.get(head, {}).get("ParameterName", head).strip()
        objects.append(index)
        for sub in subs if has_subs else [0]:
            section = places[index, sub]
            unit = units.get(section, "")
            entries.append(_description(contents, section, (index, sub), name if has_subs else "", unit))
    return Described(
        contents.get("DeviceInfo", {}).get("ProductName", "").strip(),
        _option_number(contents, "DeviceInfo", "VendorNumber"),
        _option_number(contents, "DeviceInfo", "ProductNumber"),
        tuple(objects),
        tuple(entries),
        frozenset(
            int(match[1], 16)
            for match in map(_DUMMY.match, contents.get("DummyUsage", ()))
            if match and _option_number(contents, "DummyUsage", match[0])
        ),
    )


def _description(
    contents: Contents, section: str, place: tuple[int, int], parent: str, unit: str
) -> Description:
    def text(key: str) -> str:
        return contents[section].get(key, "").strip()

    data_type = _option_number(contents, section, "DataType")
    if data_type is None:
        raise ValueError(f"[{section}] DataType is missing")
    if data_type not in datatypes.KNOWN and not _FIRST_OWN_TYPE <= data_type <= _LAST_OWN_TYPE:
        raise ValueError(f"[{section}] DataType: unknown data type {data_type:#06x}; see CiA 301, 7.4.7")
    access = text("AccessType").lower()
    if access not in ACCESS:
        said = f"{access!r} is none" if access else "is missing"
        raise ValueError(f"[{section}] AccessType {said}; use one of {', '.join(sorted(ACCESS))}")
    return Description(
        *place,
        text("ParameterName"),
        parent,
        data_type,
        access,
        bool(_option_number(contents, section, "PDOMapping")),
        text("Unit") or unit,
        section,
        text("DefaultValue"),
        text("LowLimit"),
        text("HighLimit"),
    )


def number(text: str, data_type: int, node_id: int) -> Any:
    """A default or a limit as the file writes it; None for an empty text.

    `$NODEID` is replaced; a leading 0 means octal; a hexadecimal or octal number beyond the positive range
    of a signed type is its two's complement, for a REAL its bits (CiA 306). ValueError if the text is not
    such a number.
    """
    text = text.strip()
    if not text:
        return None
    if data_type in datatypes.STRINGS:
        return text
    if data_type in datatypes.BYTES:
        return bytes.fromhex(text)
    if data_type in datatypes.FLOATS:
        return _real(text, data_type)
    if data_type not in datatypes.KNOWN:
        return None
    terms = text.removeprefix("+").split("+")
    value = sum(node_id if term.strip().upper() == "$NODEID" else whole(term) for term in terms)
    bits = datatypes.SIGNED_BITS.get(data_type, 0)
    # Some tools write the two's complement with 32 or 64 bits even for shorter types.
    wraps = [1 << width for width in (bits, 32, 64) if terms[0].startswith("0") and width >= bits > 0]
    value -= next((wrap for wrap in wraps if wrap - (1 << bits - 1) <= value < wrap), 0)
    return bool(value) if data_type == DataType.BOOLEAN else value


def whole(text: str) -> int:
    """A whole number: decimal, 0x hexadecimal, or octal with a leading 0 (CiA 306). ValueError otherwise."""
    text = text.strip()
    try:
        return int(text, 8) if _OCTAL.fullmatch(text) else int(text, 0)
    except ValueError:
        raise ValueError(f"{text[:LONGEST_MESSAGE]!r} is not a number") from None


def _real(text: str, data_type: int) -> float:
    if text.lower().startswith("0x"):
        size = datatypes.byte_length(data_type)
        data = whole(text)
        if data >> (8 * size):
            raise ValueError(f"{text} has more bits than a REAL{8 * size}")
        value: float = datatypes.decode(data_type, data.to_bytes(size, "little"))
    else:
        value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is not a finite number")
    return value


def _option_number(contents: Contents, section: str, option: str) -> int | None:
    text = contents.get(section, {}).get(option, "").strip()
    try:
        return whole(text) if text else None
    except ValueError as error:
        raise ValueError(f"[{section}] {option}: {error}") from None


def _kind(contents: Contents, section: str) -> ObjectKind:
    code = _option_number(contents, section, "ObjectType")
    try:
        return ObjectKind.VAR if code is None else ObjectKind(code)
    except ValueError:
        raise ValueError(f"[{section}] ObjectType: {code} is no object type of CiA 301") from None


def _expand_compact(contents: Contents, section: str) -> None:
    count = _option_number(contents, section, "CompactSubObj")
    options = contents[section]
    options.pop("CompactSubObj", None)
    if not count:
        return
    if not 0 < count <= 254:
        raise ValueError(f"[{section}] CompactSubObj is {count}; an object has 1 to 254 sub-indices")
    shared = {option: text for option, text in options.items() if option in _SHARED}
    name = options.get("ParameterName", "")
    names, values = (
        {int(sub): text for sub, text in contents.pop(f"{section}{what}", {}).items() if sub.isdigit()}
        for what in ("Name", "Value")
    )
    var = {"ObjectType": f"0x{ObjectKind.VAR:X}"}
    head = {"ParameterName": "Highest sub-index supported", "DataType": f"0x{DataType.UNSIGNED8:04X}"}
    contents.setdefault(f"{section}sub0", {**var, **head, "AccessType": "ro", "DefaultValue": str(count)})
    for subindex in range(1, count + 1):
        own = {"ParameterName": names.get(subindex, f"{name} {subindex}")}
        if subindex in values:
            own["DefaultValue"] = values[subindex]
        contents.setdefault(f"{section}sub{subindex:X}", {**var, **shared, **own})
