"""An EDS file (CiA 306): read once in a process for each content, and made a template of the dictionary.

`canopen.import_od` gives the objects, their names, types and access. It does not expand CompactSubObj,
drops limits of REAL32, requires a DataType for every DOMAIN and reads a negative default written in
hexadecimal as a positive number. So the file is completed first, and the numbers are read here.
Reading takes tens of milliseconds, copying a template less than one.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from configparser import Error as ParserError
from configparser import RawConfigParser
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from canopen import ObjectDictionary, import_od
from canopen.objectdictionary import ODArray, ODRecord, ODVariable

from canfb.cia301 import datatypes
from canfb.cia301.codes import SdoAbort
from canfb.cia301.datatypes import DataType
from canfb.device.od.dictionary import Entry, ObjectInfo, ObjectKind

DOMAIN = 0x02
VAR = 0x07
ARRAY = 0x08
RECORD = 0x09

LONGEST_MESSAGE = 200
_INDEX = re.compile(r"^[0-9A-Fa-f]{4}$")
_SUBINDEX = re.compile(r"^([0-9A-Fa-f]{4})[Ss]ub([0-9A-Fa-f]+)$")
_DUMMY = re.compile(r"^Dummy([0-9A-Fa-f]{4})$", re.IGNORECASE)


class EdsText(io.StringIO):
    """The text of an EDS that looks like an open file: `import_od` takes the format from the name."""

    name = "dictionary.eds"


def read(path: Path) -> RawConfigParser:
    """The sections of the file, completed. ValueError when it is not an EDS."""
    try:
        return parse(path.read_bytes())
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def parse(content: bytes) -> RawConfigParser:
    """The sections of a file with this content, completed. ValueError when it is not an EDS."""
    parser = RawConfigParser(inline_comment_prefixes=(";",))
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    try:
        parser.read_file(io.TextIOWrapper(io.BytesIO(content), encoding="utf-8", errors="replace"))
    except ParserError as error:
        said = " ".join(str(error).split())[:LONGEST_MESSAGE]  # it tells of every line
        raise ValueError(f"not an EDS: {said}") from error
    for section in [name for name in parser.sections() if _INDEX.match(name)]:
        _expand_compact(parser, section)
    for section in parser.sections():
        if _object_type(parser, section) == DOMAIN:
            _default_option(parser, section, "DataType", f"0x{DataType.DOMAIN:04X}")
            _default_option(parser, section, "AccessType", "rw")
    return parser


def as_file(parser: RawConfigParser) -> EdsText:
    """The completed file, for `import_od`."""
    text = EdsText()
    parser.write(text)
    text.seek(0)
    return text


def sections(parser: RawConfigParser) -> dict[tuple[int, int], str]:
    """Name of the section that describes each entry, by index and sub-index.

    An object with sub-indices has a section of its own too, hidden here by that of sub-index 0.
    """
    found: dict[tuple[int, int], str] = {}
    for name in parser.sections():
        if _INDEX.match(name):
            found.setdefault((int(name, 16), 0), name)
        elif match := _SUBINDEX.match(name):
            found[int(match.group(1), 16), int(match.group(2), 16)] = name
    return found


def number(text: str, data_type: int, node_id: int) -> Any:
    """A default or a limit as the file writes it; None for an empty text.

    `$NODEID` is replaced, and a hexadecimal number beyond the positive range of a signed type is
    its two's complement (CiA 306). ValueError when the text is not such a number.
    """
    text = text.strip()
    if not text:
        return None
    if data_type in datatypes.STRINGS:
        return text
    if data_type in (DataType.OCTET_STRING, DataType.DOMAIN, *datatypes.FIXED_BYTES):
        return bytes.fromhex(text)
    if data_type in datatypes.FLOATS:
        return float(text)
    value = sum(_term(term, node_id) for term in text.split("+"))
    bits = datatypes.SIGNED_BITS.get(data_type, 0)
    if bits and "0x" in text.lower() and (1 << (bits - 1)) <= value < (1 << bits):
        value -= 1 << bits
    return bool(value) if data_type == DataType.BOOLEAN else value


def dummy_types(parser: RawConfigParser) -> frozenset[int]:
    """Data types that may fill gaps of an RPDO (section DummyUsage)."""
    if not parser.has_section("DummyUsage"):
        return frozenset()
    types = set()
    for option, text in parser.items("DummyUsage"):
        match = _DUMMY.match(option)
        if match and int(text or "0", 0):
            types.add(int(match.group(1), 16))
    return frozenset(types)


def _term(term: str, node_id: int) -> int:
    term = term.strip()
    return node_id if term.upper() == "$NODEID" else int(term, 0)


def _object_type(parser: RawConfigParser, section: str) -> int:
    try:
        return int(parser.get(section, "ObjectType", fallback="") or "0", 0)
    except ValueError as error:
        raise ValueError(f"[{section}] ObjectType: {error}") from error


def _default_option(parser: RawConfigParser, section: str, option: str, value: str) -> None:
    if not parser.get(section, option, fallback=""):
        parser.set(section, option, value)


def _expand_compact(parser: RawConfigParser, section: str) -> None:
    """Write CompactSubObj (CiA 306) out as one section for each sub-index."""
    count = int(parser.get(section, "CompactSubObj", fallback="") or "0", 0)
    if parser.has_option(section, "CompactSubObj"):
        parser.remove_option(section, "CompactSubObj")
    if not count:
        return
    if not 0 < count <= 254:
        raise ValueError(f"[{section}] CompactSubObj is {count}; an object has 1 to 254 sub-indices")
    shared = {
        option: text
        for option, text in parser.items(section)
        if option in ("DataType", "AccessType", "PDOMapping", "LowLimit", "HighLimit", "DefaultValue")
    }
    name = parser.get(section, "ParameterName", fallback="")
    names = _listed(parser, f"{section}Name")
    values = _listed(parser, f"{section}Value")
    _add_section(
        parser,
        f"{section}sub0",
        {
            "ParameterName": "Highest sub-index supported",
            "DataType": f"0x{DataType.UNSIGNED8:04X}",
            "AccessType": "ro",
            "DefaultValue": str(count),
        },
    )
    for subindex in range(1, count + 1):
        own = {"ParameterName": names.get(subindex, f"{name} {subindex}")}
        if subindex in values:
            own["DefaultValue"] = values[subindex]
        _add_section(parser, f"{section}sub{subindex:X}", {**shared, **own})


def _listed(parser: RawConfigParser, section: str) -> dict[int, str]:
    if not parser.has_section(section):
        return {}
    items = {int(option): text for option, text in parser.items(section) if option.isdigit()}
    parser.remove_section(section)
    return items


def _add_section(parser: RawConfigParser, section: str, options: dict[str, str]) -> None:
    if parser.has_section(section):
        return
    parser.add_section(section)
    for option, text in {"ObjectType": f"0x{VAR:X}", **options}.items():
        parser.set(section, option, text)


@dataclass(frozen=True, slots=True)
class Template:
    """What a dictionary begins with. The entries are never given away: `fresh_entries` copies them."""

    entries: tuple[Entry, ...]
    objects: tuple[ObjectInfo, ...]
    dummies: frozenset[int]
    content: bytes

    def fresh_entries(self) -> list[Entry]:
        """Entries at their defaults, without hooks, not shared."""
        return [entry.fresh() for entry in self.entries]


def load(path: Path, node_id: int) -> Template:
    """The template of the file for this node-ID; a file that has changed is read again.

    Raises OSError when the file cannot be read, and ValueError that names the section when it describes
    something impossible.
    """
    try:
        return _template(path.read_bytes(), node_id)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


@dataclass(frozen=True, slots=True)
class _File:
    """A file as the parsers read it; never changed."""

    parser: RawConfigParser
    sections: Mapping[tuple[int, int], str]
    imported: ObjectDictionary


@lru_cache(maxsize=8)
def _file(content: bytes) -> _File:
    parser = parse(content)
    try:
        # The node-ID does not matter: $NODEID is replaced by `number`, not here.
        imported = import_od(as_file(parser), 1)
    except Exception as error:
        raise ValueError(f"not a usable EDS: {error}") from error
    return _File(parser, sections(parser), imported)


@lru_cache(maxsize=32)
def _template(content: bytes, node_id: int) -> Template:
    file = _file(content)
    entries: list[Entry] = []
    objects: list[ObjectInfo] = []
    for index in sorted(file.imported.indices):
        if index <= 0x1F:  # the dummies, which are not objects of the device
            continue
        thing = file.imported.indices[index]
        variables = _variables(thing)
        for variable in variables:
            section = file.sections[variable.index, variable.subindex]
            entries.append(_entry(file.parser, section, variable, node_id))
        subindices = tuple(variable.subindex for variable in variables)
        objects.append(ObjectInfo(index, str(thing.name), _kind(thing), subindices))
    return Template(tuple(entries), tuple(objects), dummy_types(file.parser), content)


def _variables(thing: ODVariable | ODArray | ODRecord) -> list[ODVariable]:
    if isinstance(thing, ODVariable):
        return [thing]
    return [thing.subindices[subindex] for subindex in sorted(thing.subindices)]


def _kind(thing: ODVariable | ODArray | ODRecord) -> ObjectKind:
    if isinstance(thing, ODArray):
        return ObjectKind.ARRAY
    if isinstance(thing, ODRecord):
        return ObjectKind.RECORD
    return ObjectKind.DOMAIN if thing.data_type == DataType.DOMAIN else ObjectKind.VAR


def _entry(parser: RawConfigParser, section: str, variable: ODVariable, node_id: int) -> Entry:
    data_type = int(variable.data_type or 0)

    def given(option: str) -> Any:
        try:
            return number(parser.get(section, option, fallback=""), data_type, node_id)
        except ValueError as error:
            raise ValueError(f"[{section}] {option}: {error}") from error

    try:
        entry = Entry(
            variable.index,
            variable.subindex,
            data_type,
            name=variable.name,
            access=variable.access_type,
            default=given("DefaultValue"),
            low=given("LowLimit"),
            high=given("HighLimit"),
            pdo_mappable=variable.pdo_mappable,
            follows_node_id="$NODEID" in parser.get(section, "DefaultValue", fallback="").upper(),
        )
        entry.encode()
        if entry.default is not None:
            entry.check_limits(entry.default)
    except (ValueError, SdoAbort) as error:
        raise ValueError(f"[{section}]: {error}") from error
    return entry
