"""An EDS file (CiA 306) made ready for `canopen.import_od`, and what that leaves out.

`import_od` gives the objects, their names, types and access. It does not expand CompactSubObj,
drops limits of REAL32, wants a DataType for every DOMAIN and reads a negative default written in
hexadecimal as a positive number. So the file is completed first, and the numbers are read here.
"""

from __future__ import annotations

import io
import re
from configparser import Error as ParserError
from configparser import RawConfigParser
from pathlib import Path
from typing import Any

from canfb.cia301 import datatypes
from canfb.cia301.datatypes import DataType

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
