"""The PDOs of a node, by its communication and mapping parameters (CiA 301, 7.5.2.36 to 7.5.2.40)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from canfb.cia301 import cob
from canfb.objects import Multiplexer

Number = int | float
Read = Callable[[Multiplexer], Number | None]
"""Gives the value of an object, None where it is not known."""

PDOS = 4
MOST_ENTRIES = 64  # above, sub-index 0 of a mapping stands for a multiplexed PDO


class Pdo(NamedTuple):
    """A PDO that is valid: its number, 1.., its CAN-ID, and what it maps, as in 1600h and 1A00h."""

    number: int
    can_id: int
    entries: tuple[int, ...]

    @property
    def length_bytes(self) -> int:
        """The least length of its frames."""
        return (sum(entry & 0xFF for entry in self.entries) + 7) // 8

    def carries(self, index: int) -> bool:
        """It maps at least one entry of this object."""
        return any(entry >> 16 == index for entry in self.entries)

    def bytes_of(self) -> dict[int, int]:
        """The byte at which each entry begins, of those that begin at one."""
        at: dict[int, int] = {}
        bit = 0
        for entry in self.entries:
            if bit % 8 == 0:
                at.setdefault(entry, bit // 8)
            bit += entry & 0xFF
        return at


def valid_pdos(read: Read, parameters: int, mapping: int) -> Iterator[Pdo]:
    """The valid PDOs with 11-bit identifiers; ``parameters`` and ``mapping`` are the indices of the first.

    Objects are read as the iterator goes on.
    """
    for number in range(PDOS):
        cob_id, count = read(Multiplexer(parameters + number, 1)), read(Multiplexer(mapping + number, 0))
        if cob_id is None or count is None or int(cob_id) & (cob.NOT_VALID | cob.EXTENDED):
            continue
        if count <= MOST_ENTRIES:
            places = (Multiplexer(mapping + number, sub + 1) for sub in range(int(count)))
            entries = tuple(int(read(place) or 0) for place in places)
            yield Pdo(number + 1, int(cob_id) & cob.CAN_ID, entries)
