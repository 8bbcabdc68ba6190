"""Objects of a node by its EDS: names, types, units, limits; and look-up by name.

The unit of an object is a line ``;Unit=`` above its section in our EDS files, a comment for CiA 306, or a key
``Unit`` in it, as python canopen has it.
"""

from __future__ import annotations

import io
import logging
import re
from collections.abc import Iterator
from configparser import Error, RawConfigParser
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import canopen

from canfb import objects as od
from canfb.cia301 import datatypes
from canfb.cia301.datatypes import DataType
from canfb.errors import ConfigError
from canfb.marked_yaml import read_bytes
from canfb.master.access import CommissioningError

Place = tuple[int, int]
DOMAIN_OBJECT = 0x2
MOST_LISTED = 12
LONGEST_NAME = 80  # in a message
_UNIT = re.compile(r"^; *Unit *=(.*)\r?\n(\[\w+\].*)$", re.MULTILINE)
_NUMBERED = re.compile(r"(?:0x)?([0-9a-f]{4})h?(?:[:.](?:0x)?([0-9a-f]{1,2})h?)?", re.IGNORECASE)


@dataclass(frozen=True)
class ObjectDescription:
    """One entry of an object dictionary.

    parent   name of the object, "" where the entry is all of it
    access   ro, wo, rw, rwr, rww or const
    unit     "" for none
    low      the lowest value, None where the EDS has none
    high     the highest value
    """

    index: int
    subindex: int
    name: str
    parent: str
    data_type: int
    access: str
    unit: str = ""
    low: float | None = None
    high: float | None = None

    @property
    def place(self) -> Place:
        """Index and sub-index."""
        return self.index, self.subindex

    @property
    def number(self) -> str:
        """2010:01."""
        return od.place_text(self.place)

    @property
    def title(self) -> str:
        """Supervision: Residual limit."""
        return f"{self.parent}: {self.name}" if self.parent else self.name

    @property
    def readable(self) -> bool:
        """SDO may read it."""
        return self.access != "wo"

    @property
    def writable(self) -> bool:
        """SDO may write it."""
        return self.access in ("wo", "rw", "rwr", "rww")

    def decode(self, data: bytes) -> Any:
        """The value of bytes from the bus. ValueError where their number is not that of the type."""
        return datatypes.decode(self.data_type, data)


class ObjectDescriptions:
    """The objects of a node, of the EDS or DCF ``path``. CommissioningError for a file that is none."""

    def __init__(self, path: Path, node_id: int) -> None:
        self.path = path
        self.product, self.identity, self._entries = _described(path, node_id, _modified(path))

    def __iter__(self) -> Iterator[ObjectDescription]:
        return iter(self._entries.values())

    def find(self, index: int, subindex: int) -> ObjectDescription | None:
        """The entry, None if the EDS does not have it."""
        return self._entries.get((index, subindex))

    def of_object(self, index: int) -> list[ObjectDescription]:
        """All entries of an index, ascending."""
        return [self._entries[place] for place in sorted(self._entries) if place[0] == index]

    def meant(self, text: str) -> list[ObjectDescription]:
        """The entries that are meant: one, or all of a record or an array that is named as a whole.

        ``text`` is a number, 2010:01 or 0x2010:1, or a name or its beginning, whatever its case: that of the
        entry, that of the object, or both. ConfigError for one that is not known, or means several.
        """
        place = numbered(text)
        text = text[:LONGEST_NAME]
        return self._numbered(text, *place) if place else self._named(text)

    def _numbered(self, text: str, index: int, subindex: int | None) -> list[ObjectDescription]:
        whole = self.of_object(index)
        found = [one for one in whole if subindex in (None, one.subindex)]
        if not found:
            what = "has no such sub-index" if whole else "has no such object"
            raise ConfigError(f"{text}: {self.product} {what} ({self.path.name})")
        return found

    def _named(self, text: str) -> list[ObjectDescription]:
        query = _words(text)
        if not query:
            raise ConfigError(f"{text!r}: a number such as 2010:01, or the name of an object, is required")
        for fits in (str.__eq__, str.startswith):
            own = [one for one in self if fits(_words(one.name), query) or fits(_words(one.title), query)]
            whole = {one.index for one in self if one.parent and fits(_words(one.parent), query)}
            outside = [one for one in own if one.index not in whole]
            if len(whole) == 1 and not outside:
                return self.of_object(whole.pop())
            if len(own) == 1 and not whole:
                return own
            if own or whole:
                several = [f"{one.number} {one.title}" for one in outside]
                several += [f"{index:04X} {self.of_object(index)[0].parent}" for index in whole]
                raise ConfigError(f"{text!r} means several objects: {_listed(sorted(several))}")
        near = [
            f"{one.number} {one.title}" for one in self if set(query.split()) & set(_words(one.title).split())
        ]
        hint = f"; is it one of these: {_listed(near)}?" if near else f"; {self.path.name} has the names"
        raise ConfigError(f"{text!r}: {self.product} has no object of this name{hint}")


def numbered(text: str) -> tuple[int, int | None] | None:
    """Index and sub-index of 2010:01, 0x2010:1 or 2010h; None if the text is no number."""
    match = _NUMBERED.fullmatch(text.strip())
    if match is None:
        return None
    return int(match[1], 16), None if match[2] is None else int(match[2], 16)


def _words(text: str) -> str:
    return " ".join(re.findall(r"[a-z0-9]+", text.lower()))


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else ""
    return ", ".join(names[:MOST_LISTED]) + more


def _modified(path: Path) -> tuple[int, int] | None:
    """Time (ns) and length of the file; None for one that cannot be read, which reading it will say."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size


@lru_cache(maxsize=8)
def _described(
    path: Path, node_id: int, modified: tuple[int, int] | None
) -> tuple[str, tuple[Any, Any], dict[Place, ObjectDescription]]:
    """Product, vendor and product number, and entries; nobody changes them.

    Reading the EDS of the module is most of what a short command computes, and a backup needs it twice.
    """
    imported = _imported(path, node_id)
    information = imported.device_information
    entries = {one.place: one for thing in imported.values() for one in _entries(thing)}
    identity = (information.vendor_number, information.product_number)
    return str(information.product_name or path.name), identity, entries


def _imported(path: Path, node_id: int) -> Any:
    """python canopen's dictionary of the file."""
    parser = RawConfigParser(inline_comment_prefixes=(";",))
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    text = read_bytes(path, CommissioningError).decode("utf-8", errors="replace")
    canopens = logging.getLogger("canopen.objectdictionary")
    level = canopens.level
    try:
        canopens.setLevel(logging.CRITICAL)  # an oddity of the file that does no harm
        parser.read_string(_UNIT.sub(r"\2\nUnit=\1", text))
        if not parser.has_section("DeviceInfo"):
            raise ValueError("[DeviceInfo] is missing")
        for section in parser.sections():  # CiA 306: a DOMAIN need not say its type
            if int(parser.get(section, "ObjectType", fallback="0") or "0", 0) == DOMAIN_OBJECT:
                for option, value in (("DataType", f"0x{DataType.DOMAIN:04X}"), ("AccessType", "rw")):
                    if not parser.get(section, option, fallback=""):
                        parser.set(section, option, value)
        file = io.StringIO()
        parser.write(file)
        file.seek(0)
        file.name = "objects.eds"
        return canopen.import_od(file, node_id)
    except (Error, ValueError, KeyError, TypeError, AttributeError) as error:
        said = " ".join(str(error).split())[:200]
        raise CommissioningError(f"{path}: this is not an EDS: {said}") from None
    finally:
        canopens.setLevel(level)


def _entries(thing: Any) -> Iterator[ObjectDescription]:
    if isinstance(thing, canopen.objectdictionary.ODVariable):
        if thing.index >= 0x1000:  # below are the dummies of PDO mappings
            yield _entry(thing, "")
        return
    for subindex in sorted(thing.subindices):
        yield _entry(thing.subindices[subindex], str(thing.name))


def _entry(variable: Any, parent: str) -> ObjectDescription:
    return ObjectDescription(
        int(variable.index),
        int(variable.subindex),
        str(variable.name),
        parent,
        int(variable.data_type or DataType.DOMAIN),
        str(variable.access_type),
        str(variable.unit),
        variable.min,
        variable.max,
    )
