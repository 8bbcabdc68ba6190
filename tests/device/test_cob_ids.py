"""Conformance case Other 10, and rows 14 and 16 of the list beyond: COB-IDs of every object."""

from __future__ import annotations

from pathlib import Path

import pytest
from device_kit import ID, OK, Bench

from canfb.cia301.codes import AbortCode
from canfb.device.od.dictionary import Dictionary
from folding import each

SHIPPED = Path(__file__).parents[2] / "eds"
RANGES = [(0x000, 0x07F), (0x101, 0x180), (0x581, 0x5FF), (0x601, 0x67F), (0x6E0, 0x6FF), (0x701, 0x7FF)]
RESTRICTED = [can_id for first, last in RANGES for can_id in range(first, last + 1)]
FREE = [can_id for can_id in range(0x800) if can_id not in RESTRICTED]
BIT_29, BIT_30, BIT_31 = 1 << 29, 1 << 30, 1 << 31

SWITCHED_ON = [(0x1005, 0), (0x1012, 0)]
"""Objects (index, sub-index) that a bit of their COB-ID switches on ..."""
SWITCHED_OFF = [(0x1014, 0), (0x1400, 1), (0x1401, 1), (0x1800, 1), (0x1801, 1), (0x1802, 1), (0x1803, 1)]
SWITCHED_OFF += [(0x1201, 1), (0x1201, 2)]
"""... and those that bit 31 switches off."""


@pytest.fixture
def module() -> Bench:
    bench = Bench(Dictionary.load(SHIPPED / "canfb-module.eds", ID))
    bench.start()
    return bench


@pytest.mark.parametrize(("index", "subindex"), SWITCHED_OFF)
def test_any_other_can_id_by_way_of_bit_31(module: Bench, index: int, subindex: int) -> None:
    keep = BIT_30 if index & 0xFF00 == 0x1800 else 0
    value = module.read(index, subindex)
    assert module.write(index, subindex, value | BIT_31, 4) == OK
    for can_id in FREE[::9]:
        assert module.write(index, subindex, can_id | keep, 4) == OK
        other = FREE[FREE.index(can_id) - 1]
        assert module.write(index, subindex, other | keep, 4) is AbortCode.INVALID_VALUE
        assert module.read(index, subindex) == can_id | keep
        assert module.write(index, subindex, can_id | keep | BIT_31, 4) == OK
    for can_id in (edge for edges in RANGES for edge in edges):
        assert module.write(index, subindex, can_id | keep, 4) is AbortCode.INVALID_VALUE


@each("index, subindex", SWITCHED_ON + SWITCHED_OFF)
@each("bits", [BIT_29, 1 << 11, 1 << 28, 0x1FFFF800])
def test_frames_of_29_bits(module: Bench, index: int, subindex: int, bits: int) -> None:
    value = module.read(index, subindex)
    for switch in (0, BIT_31):
        assert module.write(index, subindex, value | bits | switch, 4) is AbortCode.INVALID_VALUE
    assert module.read(index, subindex) == value
