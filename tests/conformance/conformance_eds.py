"""What the EDS files say, read with the standard library alone: independent of the loader of the device."""

from __future__ import annotations

import struct
from configparser import RawConfigParser
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

FOLDER = Path(__file__).parents[2] / "eds"

REAL32, VISIBLE_STRING, DOMAIN = 0x08, 0x09, 0x0F
SIZES = {
    0x01: 1, 0x02: 1, 0x03: 2, 0x04: 4, 0x05: 1, 0x06: 2, 0x07: 4, 0x08: 4,
    0x0C: 6, 0x0D: 6, 0x10: 3, 0x11: 8, 0x15: 8, 0x16: 3, 0x1B: 8,
}  # fmt: skip
OBJECT_DOMAIN = 0x02


@dataclass(frozen=True)
class EdsEntry:
    """One sub-index, as the file has it."""

    index: int
    sub: int
    name: str
    data_type: int
    access: str
    default: str
    low: str
    high: str
    mappable: bool
    node_id: int
    flags: int = 0

    @property
    def m(self) -> str:
        """Multiplexer of an SDO frame: index low, index high, sub-index."""
        return f"{self.index & 0xFF:02X} {self.index >> 8:02X} {self.sub:02X}"

    @property
    def readable(self) -> bool:
        return self.access != "wo"

    @property
    def writable(self) -> bool:
        return self.access in ("rw", "wo", "rww", "rwr")

    @property
    def size(self) -> int:
        """Bytes of a value; 0 for strings and DOMAIN."""
        return SIZES.get(self.data_type, 0)

    @property
    def mapping(self) -> int:
        """The entry of a PDO mapping that names this object."""
        return self.index << 16 | self.sub << 8 | 8 * self.size

    def integer(self, text: str) -> int:
        """A number as the file writes it, $NODEID replaced."""
        total = 0
        for term in text.split("+"):
            name = term.strip()
            total += self.node_id if name.upper() == "$NODEID" else int(name, 0)
        return total

    def raw(self, text: str) -> bytes:
        """The bytes that a default or a limit means."""
        if self.data_type == VISIBLE_STRING:
            return text.encode("latin-1")
        if self.data_type == REAL32:
            return struct.pack("<f", float(text))
        return self.little(self.integer(text))

    def little(self, value: int) -> bytes:
        """A number in the bytes of this type."""
        return (value % (1 << 8 * self.size)).to_bytes(self.size, "little")

    def __str__(self) -> str:
        return f"{self.index:04X}_{self.sub:02X}"


@dataclass
class Eds:
    """One EDS file for a node-ID."""

    name: str
    node_id: int
    entries: dict[tuple[int, int], EdsEntry] = field(init=False)
    objects: dict[int, int] = field(init=False)
    """Object type by index."""

    def __post_init__(self) -> None:
        parser = RawConfigParser()
        parser.read(FOLDER / f"{self.name}.eds")
        self._parser = parser
        self.entries, self.objects = {}, {}
        for section in parser.sections():
            index, found, sub = section.lower().partition("sub")
            if len(index) != 4 or not parser.has_option(section, "ParameterName"):
                continue
            if not found:
                self.objects[int(index, 16)] = int(parser[section].get("ObjectType", "0x7"), 0)
            if found or parser.has_option(section, "AccessType"):
                entry = self._entry(section, int(index, 16), int(sub or "0", 16))
                self.entries[entry.index, entry.sub] = entry

    def _entry(self, section: str, index: int, sub: int) -> EdsEntry:
        options = parser = self._parser[section]
        object_type = int(options.get("ObjectType", "0x7"), 0)
        return EdsEntry(
            index,
            sub,
            options["ParameterName"],
            int(parser.get("DataType", hex(DOMAIN) if object_type == OBJECT_DOMAIN else "0"), 0),
            options.get("AccessType", "rw").lower(),
            options.get("DefaultValue", ""),
            options.get("LowLimit", ""),
            options.get("HighLimit", ""),
            int(options.get("PDOMapping", "0") or "0", 0) == 1,
            self.node_id,
            int(options.get("ObjFlags", "0") or "0", 0),
        )

    def has(self, index: int, sub: int = 0) -> bool:
        return (index, sub) in self.entries

    def __getitem__(self, key: tuple[int, int]) -> EdsEntry:
        return self.entries[key]

    @cached_property
    def dummies(self) -> set[int]:
        """Data types that an RPDO may map to fill a gap."""
        if not self._parser.has_section("DummyUsage"):
            return set()
        return {int(name[5:], 16) for name, on in self._parser.items("DummyUsage") if int(on or "0", 0)}

    def numbers(self, first: int) -> list[int]:
        """Numbers of the PDOs (from 1) whose communication parameters begin at `first`."""
        return [number for number in range(1, 513) if self.has(first + number - 1, 1)]

    def mappable(self, *access: str, size: int | None = None) -> list[EdsEntry]:
        """Objects that a PDO may carry, with this access, of `size` bytes."""
        return [
            entry
            for entry in self.entries.values()
            if entry.mappable and entry.access in access and size in (None, entry.size)
        ]
