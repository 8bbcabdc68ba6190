"""PDO 21 to PDO 33: mapping."""

from typing import NamedTuple

import pytest
from conformance_eds import EdsEntry
from conformance_kit import INVALID, G, Tester, little, m

LENGTH = ("06040042", "06040041", "06010000", "06020000")
NOT_NOW = ("06010000", "06040041", G)
NOT_MAPPABLE = ("06020000", "06040041")


class Pdo(NamedTuple):
    """Where the parameters of a PDO are, and which access its objects have."""

    communication: int
    mapping: int
    access: tuple[str, ...]


def pdos(tester: Tester) -> list[Pdo]:
    return rpdos(tester) + tpdos(tester)


def rpdos(tester: Tester) -> list[Pdo]:
    return [Pdo(index, index + 0x200, ("rww", "rw", "wo")) for index in tester.rpdos]


def tpdos(tester: Tester) -> list[Pdo]:
    return [Pdo(index, index + 0x200, ("ro", "rwr", "rw", "const")) for index in tester.tpdos]


def switch_off(tester: Tester, pdo: Pdo) -> int:
    """Bit 31 on; the COB-ID that brings it back."""
    cob_id = tester.read(pdo.communication, 1) & ~INVALID
    tester.write(pdo.communication, 1, cob_id | INVALID, 4)
    return cob_id


def empty(tester: Tester, pdo: Pdo) -> int:
    """Off, and without mapped objects."""
    cob_id = switch_off(tester, pdo)
    tester.accept(f"2F {m(pdo.mapping)} 00")
    return cob_id


def mapping(pdo: Pdo, value: int, sub: int = 1) -> str:
    """The request that maps an object."""
    return f"23 {m(pdo.mapping, sub)} {little(value, 4)}"


def one(entries: list[EdsEntry]) -> EdsEntry:
    assert entries
    return entries[0]


def test_pdo_21_mapped_objects_are_mappable(tester: Tester) -> None:
    seen = 0
    for pdo in pdos(tester):
        for sub in range(1, tester.read(pdo.mapping) + 1):
            value = tester.read(pdo.mapping, sub)
            entry = tester.eds[value >> 16, value >> 8 & 0xFF]
            assert entry.mappable
            assert entry.access in pdo.access
            assert value & 0xFF == 8 * entry.size
            assert 0 < len(tester.upload(entry.m)) == entry.size
            seen += 1
    assert seen


def test_pdo_22_changing_the_mapping(tester: Tester) -> None:
    for pdo in pdos(tester):
        entry = one(tester.eds.mappable(*pdo.access))
        number = max(1, tester.read(pdo.mapping))
        values = [entry.mapping] + [tester.read(pdo.mapping, sub) for sub in range(2, number + 1)]
        cob_id = empty(tester, pdo)
        tester.accept(mapping(pdo, entry.mapping))
        tester.accept(f"2F {m(pdo.mapping)} {number:02X}")
        tester.write(pdo.communication, 1, cob_id, 4)
        assert [tester.read(pdo.mapping, sub) for sub in range(1, number + 1)] == values


def test_pdo_23_and_24_mapping_while_it_counts_objects_and_of_a_valid_pdo(tester: Tester) -> None:
    for pdo in [pdo for pdo in pdos(tester) if not tester.read(pdo.communication, 1) >> 31]:
        before = tester.read(pdo.mapping, 1)
        tester.refuse(mapping(pdo, before), *NOT_NOW)
        tester.refuse(f"2F {m(pdo.mapping)} 00", *NOT_NOW)
        assert tester.read(pdo.mapping, 1) == before
        switch_off(tester, pdo)
        assert tester.read(pdo.mapping) > 0
        tester.refuse(mapping(pdo, before), *NOT_NOW)
        assert tester.read(pdo.mapping, 1) == before


@pytest.mark.parametrize(("size", "too_many", "taken"), [(1, ("09",), "08"), (4, ("08", "03"), "02")])
def test_pdo_25_and_26_more_objects_than_places_and_more_bits_than_a_frame_has(
    tester: Tester, size: int, too_many: tuple[str, ...], taken: str
) -> None:
    for pdo in pdos(tester):
        entry = one(tester.eds.mappable(*pdo.access, size=size))
        empty(tester, pdo)
        for sub in range(1, 9):
            tester.accept(mapping(pdo, entry.mapping, sub))
        for number in too_many:
            assert tester.refuse(f"2F {m(pdo.mapping)} {number}", *LENGTH) == "06040042"
            assert tester.read(pdo.mapping) == 0
        tester.accept(f"2F {m(pdo.mapping)} {taken}")


def takes(tester: Tester, pdo: Pdo, *values: int) -> None:
    for value in values:
        empty(tester, pdo)
        tester.accept(mapping(pdo, value))
        tester.accept(f"2F {m(pdo.mapping)} 01")


def refuses(tester: Tester, pdo: Pdo, *values: int) -> None:
    empty(tester, pdo)
    for value in values:
        tester.refuse(mapping(pdo, value), *NOT_MAPPABLE)


def written(tester: Tester) -> list[int]:
    """The objects that an RPDO may carry."""
    entries = tester.eds.mappable("rww", "wo")
    assert entries
    return [entry.mapping for entry in entries]


def test_pdo_27_to_29_rpdo_of_what_is_written_read_only_or_not_mappable(tester: Tester) -> None:
    for pdo in rpdos(tester):
        takes(tester, pdo, *written(tester))
        refuses(tester, pdo, 0x10010008, 0x10170010)


def test_pdo_30_and_32_tpdo_of_what_is_read_only_or_not_mappable(tester: Tester) -> None:
    for pdo in tpdos(tester):
        takes(tester, pdo, 0x10010008)
        refuses(tester, pdo, 0x10000020)


def test_pdo_31_tpdo_of_an_object_to_be_written(tester: Tester) -> None:
    for pdo in tpdos(tester):
        refuses(tester, pdo, *written(tester))


def test_pdo_33_rpdo_with_a_dummy(tester: Tester) -> None:
    bits = {2: 8, 3: 16, 4: 32, 5: 8, 6: 16, 7: 32}
    assert tester.eds.dummies
    for pdo in rpdos(tester):
        takes(tester, pdo, *(kind << 16 | bits[kind] for kind in sorted(tester.eds.dummies)))


@pytest.mark.parametrize("value", ["08 00 02 00", "10 00 03 00", "20 00 07 00"])
def test_pdo_33_as_the_list_writes_it(tester: Tester, value: str) -> None:
    tester.accept("23 00 14 01 90 01 00 80")
    tester.accept("2F 00 16 00 00")
    tester.accept(f"23 00 16 01 {value}")


def test_a_dummy_takes_its_place(tester: Tester) -> None:
    """An RPDO with a gap of 16 bits before the sine: the sine is the second word."""
    for pdo in rpdos(tester)[:1]:
        cob_id = empty(tester, pdo)
        tester.accept(mapping(pdo, 0x00060010, 1))
        tester.accept(mapping(pdo, 0x20000110, 2))
        tester.accept(f"2F {m(pdo.mapping)} 02")
        tester.write(pdo.communication, 1, cob_id, 4)
        tester.operational()
        tester.send(cob_id & 0x7FF, "11 22 33 44")
        assert tester.ask("40 00 20 01") == "4B 00 20 01 33 44 00 00"
