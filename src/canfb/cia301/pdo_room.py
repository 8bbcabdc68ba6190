"""Objects in PDOs, in their order, each PDO as full as it gets (CiA 301, 7.5.2.36)."""

from __future__ import annotations

from collections.abc import Iterable

LONGEST_BITS = 64


def in_pdos(mapped: Iterable[int]) -> list[list[int]]:
    """Mapping entries (index, sub-index, bits), shared out to as many PDOs as they need."""
    pdos: list[list[int]] = [[]]
    for entry in mapped:
        if sum(one & 0xFF for one in pdos[-1]) + (entry & 0xFF) > LONGEST_BITS:
            pdos.append([])
        pdos[-1].append(entry)
    return pdos


def mapping_values(first_index: int, mapped: Iterable[int]) -> dict[tuple[int, int], int]:
    """The mapping parameters, by index and sub-index, of the PDOs that :func:`in_pdos` gives."""
    values: dict[tuple[int, int], int] = {}
    for index, entries in enumerate(in_pdos(mapped), first_index):
        values |= {(index, place): entry for place, entry in enumerate(entries, 1)}
        values[index, 0] = len(entries)
    return values
