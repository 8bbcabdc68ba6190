"""A CAN frame, input and output of a node; and the distribution of objects to PDOs."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, Self

HIGHEST_ID = 0x7FF
LONGEST_DATA = 8


class Frame(NamedTuple):
    """One CAN frame with an 11-bit identifier.

    `can_id` is 0 to 7FFh, `data` 0 to 8 bytes, `rtr` marks a remote frame, `timestamp` is the time of
    reception in seconds, on the clock of `now`, or None. Nothing is checked here, as a bus may deliver
    anything; :meth:`checked` does.
    """

    can_id: int
    data: bytes
    rtr: bool = False
    timestamp: float | None = None

    @classmethod
    def checked(
        cls, can_id: int, data: bytes = b"", rtr: bool = False, timestamp: float | None = None
    ) -> Self:
        """A frame whose fields are within their ranges. TypeError or ValueError otherwise."""
        if not isinstance(can_id, int) or isinstance(can_id, bool):
            raise TypeError(f"can_id must be a whole number, not {can_id!r}")
        if not 0 <= can_id <= HIGHEST_ID:
            raise ValueError(f"can_id must be 0 to 7FFh (11 bits), not {can_id:X}h")
        if not isinstance(data, (bytes, bytearray, memoryview)):
            raise TypeError(f"data must be bytes, not {type(data).__name__}")
        if len(data) > LONGEST_DATA:
            raise ValueError(f"data must be 0 to 8 bytes, not {len(data)}: CANopen has no CAN FD")
        if not isinstance(rtr, bool):
            raise TypeError(f"rtr must be true or false, not {rtr!r}")
        if timestamp is not None and not isinstance(timestamp, (int, float)):
            raise TypeError(f"timestamp must be seconds or None, not {timestamp!r}")
        return cls(can_id, bytes(data), rtr, timestamp)


def frame_bits(data_bytes: int, *, extended: bool = False) -> int:
    """Bits of a data frame on the wire, with the most stuff bits and the interframe space (ISO 11898-1).

    ``data_bytes`` is 0 to 8, ``extended``: with a 29-bit identifier.
    """
    stuffed = (54 if extended else 34) + 8 * data_bytes
    return stuffed + 13 + (stuffed - 1) // 4


LONGEST_BITS = 64


def in_pdos(mapped: Iterable[int]) -> list[list[int]]:
    """Distribute mapping entries (index, sub-index, bits) to as many PDOs as they need."""
    pdos: list[list[int]] = [[]]
    for entry in mapped:
        if sum(one & 0xFF for one in pdos[-1]) + (entry & 0xFF) > LONGEST_BITS:
            pdos.append([])
        pdos[-1].append(entry)
    return pdos


def mapping_values(first_index: int, mapped: Iterable[int]) -> dict[tuple[int, int], int]:
    """The mapping parameters, by index and sub-index, of the PDOs of :func:`in_pdos`."""
    values: dict[tuple[int, int], int] = {}
    for index, entries in enumerate(in_pdos(mapped), first_index):
        values |= {(index, place): entry for place, entry in enumerate(entries, 1)}
        values[index, 0] = len(entries)
    return values
