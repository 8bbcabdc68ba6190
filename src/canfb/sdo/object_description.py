"""Objects of a node by its EDS, and look-up by name."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from typing import Any

from canfb import objects as od
from canfb.cia301 import datatypes
from canfb.device.od import eds
from canfb.errors import ConfigError, saying
from canfb.files import read_bytes
from canfb.master.access import CommissioningError
from canfb.rows import listed

Place = tuple[int, int]
LONGEST_NAME = 80  # longest text quoted in a message
EXPEDITED = 4  # Data bytes of an expedited answer (CiA 301, 7.2.4.3.3).
_COMMUNICATION = range(0x1000, 0x2000)
_NUMBERED = re.compile(r"(?:0x)?([0-9a-f]{4})h?(?:[:.](?:0x)?([0-9a-f]{1,2})h?)?", re.IGNORECASE)


@dataclass(frozen=True)
class ObjectDescription(eds.Description):
    """One entry, with its limits as numbers."""

    least: float | None
    most: float | None

    @property
    def place(self) -> Place:
        return self.index, self.subindex

    @property
    def number(self) -> str:
        return od.place_text(self.place)

    @property
    def title(self) -> str:
        return f"{self.parent}: {self.name}" if self.parent else self.name

    @property
    def readable(self) -> bool:
        return self.access != "wo"

    @property
    def writable(self) -> bool:
        return self.access in ("wo", "rw", "rwr", "rww")

    @property
    def holds_bits(self) -> bool:
        # UNSIGNED32 without a unit is a COB-ID, a mapping entry or a CRC: hexadecimal.
        is_plain = self.data_type == datatypes.DataType.UNSIGNED32 and not self.unit
        return is_plain and (self.index in _COMMUNICATION or "CRC" in self.name)

    def decode(self, data: bytes) -> Any:
        """The value of bytes from the bus; ValueError for too few.

        The type determines how many bytes of an expedited answer are used: some slaves do not indicate the
        size (42h), or always indicate four.
        """
        size = datatypes.byte_length(self.data_type)
        if size and len(data) <= EXPEDITED:
            data = data[:size]
        return datatypes.decode(self.data_type, data)


class ObjectDescriptions:
    """The objects of a node by an EDS or DCF; CommissioningError for any other file."""

    def __init__(self, path: Path, node_id: int) -> None:
        self.path = path
        content = read_bytes(path, CommissioningError)
        with saying(CommissioningError, str(path), ValueError):
            described = eds.content_described(content)
            self._entries = _described(content, node_id)
        if not self._entries:
            raise CommissioningError(f"{path}: not an EDS: it has no object")
        self.product = described.product_name or path.name
        self.identity = (described.vendor, described.product)

    def __iter__(self) -> Iterator[ObjectDescription]:
        return iter(self._entries.values())

    def find(self, index: int, subindex: int) -> ObjectDescription | None:
        return self._entries.get((index, subindex))

    def entry(self, index: int, subindex: int) -> ObjectDescription:
        """The entry; KeyError if missing."""
        return self._entries[index, subindex]

    def of_object(self, index: int) -> list[ObjectDescription]:
        return [self._entries[place] for place in sorted(self._entries) if place[0] == index]

    def meant(self, text: str) -> list[ObjectDescription]:
        """The entry, or all entries of a record or array, by number (2010:01) or the beginning of a name.

        ConfigError for no or several matches.
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
            whole = {one.index for one in self if one.parent and fits(_words(one.parent), query)}
            outside = [
                one
                for one in self
                if one.index not in whole
                and (fits(_words(one.name), query) or fits(_words(one.title), query))
            ]
            found = [[one] for one in outside] + [self.of_object(index) for index in whole]
            if len(found) == 1:
                return found[0]
            if found:
                several = [f"{one.number} {one.title}" for one in outside]
                several += [f"{index:04X} {self.of_object(index)[0].parent}" for index in whole]
                raise ConfigError(f"{text!r} means several objects: {listed(sorted(several))}")
        names = {_words(name): f"{one.number} {one.title}" for one in self for name in (one.title, one.name)}
        near = [names[name] for name in get_close_matches(query, names, n=3, cutoff=0.8)]
        near = near or [names[name] for name in names if set(query.split()) & set(name.split())]
        meant = listed(list(dict.fromkeys(near)))
        hint = f"; did you mean {meant}?" if near else f"; {self.path.name} has the names"
        raise ConfigError(f"{text!r}: {self.product} has no object of this name{hint}")


def numbered(text: str) -> tuple[int, int | None] | None:
    """Index and sub-index of 2010:01 or 2010h, or None."""
    match = _NUMBERED.fullmatch(text.strip())
    if match is None:
        return None
    return int(match[1], 16), None if match[2] is None else int(match[2], 16)


def _words(text: str) -> str:
    return " ".join(re.findall(r"[a-z0-9]+", text.lower()))


@lru_cache(maxsize=8)
def _described(content: bytes, node_id: int) -> dict[Place, ObjectDescription]:
    return {
        (one.index, one.subindex): ObjectDescription(**asdict(one), least=low, most=high)
        for one in eds.content_described(content).entries
        for low, high in [one.limits(node_id)]
    }
