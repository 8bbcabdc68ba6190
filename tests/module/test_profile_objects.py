"""Each object of CiA 406 that an encoder with one channel has: type, access, mapping, default."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import NamedTuple

import pytest
from canopen import SdoAbortedError
from module_bench import Bench

from canfb.device.od.dictionary import Dictionary, Entry
from canfb.eds_files import eds_path
from folding import each

PROJECT = Path(__file__).parents[2] / "pyproject.toml"
U8, U16, U32, U64, I16, I32 = 0x5, 0x6, 0x7, 0x1B, 0x3, 0x4
SIZES = {U8: 1, U16: 2, U32: 4, U64: 8, I16: 2, I32: 4}


class Row(NamedTuple):
    """One object as the profile has it; `channels`: an ARRAY with one entry per channel."""

    data_type: int
    access: str
    mappable: bool
    default: int | None = None  # None: a value that is measured
    channels: bool = False


RO, RW = "ro", "rw"
PROFILE = {
    0x6000: Row(U16, RW, False, 0),
    0x6001: Row(U32, RW, False, 2500 * 8192),
    0x6002: Row(U32, RW, False, 209 * 2500 * 8192),
    0x6003: Row(U32, RW, False, 0),
    0x6004: Row(U32, RO, True),
    0x6008: Row(U64, RO, True),
    0x6009: Row(U64, RW, False, 0),
    0x600C: Row(U32, RO, True),
    0x6030: Row(I16, RO, True, channels=True),
    0x6040: Row(I16, RO, True, channels=True),
    0x6200: Row(U16, RW, False, 0),
    0x6300: Row(U8, RO, True, channels=True),
    0x6301: Row(U8, RW, False, 0, channels=True),
    0x6302: Row(U8, RW, False, 0, channels=True),
    **{0x6310 + n: Row(I32, RW, False, 0, channels=True) for n in range(8)},
    **{0x6320 + n: Row(I32, RW, False, 0, channels=True) for n in range(8)},
    **{0x6330 + n: Row(U16, RW, False, 0, channels=True) for n in range(8)},
    0x6400: Row(U8, RO, True, channels=True),
    0x6401: Row(I32, RW, False, 0, channels=True),
    0x6402: Row(I32, RW, False, -1, channels=True),
    0x6500: Row(U16, RO, False, 0),
    0x6501: Row(U32, RO, False, 2500 * 8192),
    0x6502: Row(U16, RO, False, 209),
    0x6503: Row(U16, RO, True),
    0x6504: Row(U16, RO, False, 0x1001),
    0x6505: Row(U16, RO, True),
    0x6506: Row(U16, RO, False, 0x3023),
    0x6507: Row(U32, RO, False, 0x00030302),
    0x6508: Row(U32, RO, False, 0xFFFFFFFF),
    0x6509: Row(I32, RO, False, 0),
    0x650B: Row(U32, RO, False, 4711),
}
PLACES = [(index, 1 if row.channels else 0) for index, row in PROFILE.items()]


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(serial_number=4711)


def entry_at(bench: Bench, index: int, subindex: int) -> Entry:
    return bench.module.dictionary.entry(index, subindex)


def test_the_table_is_complete() -> None:
    dictionary = Dictionary.load(eds_path("canfb-module"), 32)
    there = {info.index for info in dictionary.objects() if info.index >= 0x6000}
    assert there == set(PROFILE) | {0x650A}


@each("index, subindex", PLACES)
def test_it_is_that_of_the_profile(bench: Bench, index: int, subindex: int) -> None:
    row, entry = PROFILE[index], entry_at(bench, index, subindex)
    assert (entry.data_type, entry.access, entry.pdo_mappable) == row[:3]
    data = bench.remote.sdo.upload(index, subindex)
    assert len(data) == SIZES[row.data_type]
    value = int.from_bytes(data, "little", signed=row.data_type in (I16, I32))
    assert value == (row.default or 0)
    if row.channels:
        assert bench.remote.sdo.upload(index, 0) == b"\1"
        with pytest.raises(SdoAbortedError, match="06090011"):
            bench.remote.sdo.upload(index, 2)
    else:
        with pytest.raises(SdoAbortedError, match="06090011"):
            bench.remote.sdo.upload(index, 1)


@pytest.mark.parametrize(("index", "subindex"), PLACES, ids=lambda value: f"{value:X}")
def test_it_can_be_written_if_it_is_rw(bench: Bench, index: int, subindex: int) -> None:
    row, entry = PROFILE[index], entry_at(bench, index, subindex)
    size = SIZES[row.data_type]
    if row.access == RO:
        with pytest.raises(SdoAbortedError, match="06010002"):
            bench.remote.sdo.download(index, subindex, bytes(size))
        return
    with pytest.raises(SdoAbortedError, match="06070012"):
        bench.remote.sdo.download(index, subindex, bytes(size + 1))
    if index in (0x6003, 0x6009):
        with pytest.raises(SdoAbortedError, match="08000022"):  # there is no position yet
            bench.remote.sdo.download(index, subindex, bytes(size))
        return
    bench.remote.sdo.download(index, subindex, b"\1".ljust(size, b"\0"))
    assert bench.remote.sdo.upload(index, subindex) == b"\1".ljust(size, b"\0")
    bench.remote.sdo.download(index, subindex, entry.default.to_bytes(size, "little", signed=index == 0x6402))


@each("index, subindex", PLACES)
def test_it_can_be_mapped_if_the_profile_says_so(bench: Bench, index: int, subindex: int) -> None:
    row, sdo = PROFILE[index], bench.sdo
    sdo[0x1802][1].raw = 0x800003A0
    sdo[0x1A02][0].raw = 0
    mapped = index << 16 | subindex << 8 | SIZES[row.data_type] * 8
    if not row.mappable:
        with pytest.raises(SdoAbortedError, match="06040041"):
            sdo[0x1A02][1].raw = mapped
        return
    sdo[0x1A02][1].raw = mapped
    sdo[0x1A02][0].raw = 1
    assert sdo[0x1A02][1].raw == mapped


def test_the_module_identification(bench: Bench) -> None:
    assert [bench.sdo[0x650A][n].raw for n in range(4)] == [3, 0, 0, 0x7FFFFFFF]
    for subindex in range(1, 4):
        entry = entry_at(bench, 0x650A, subindex)
        assert (entry.data_type, entry.access, entry.pdo_mappable) == (I32, RO, False)


def test_the_software_version_is_that_of_the_package(bench: Bench) -> None:
    major, minor, *_ = map(
        int, tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]["version"].split(".")
    )
    assert bench.sdo[0x6507].raw >> 16 == major << 8 | minor
    assert bench.sdo[0x6507].raw & 0xFFFF == 0x0302


def test_the_serial_number_is_that_of_1018h(bench: Bench) -> None:
    assert bench.sdo[0x650B].raw == bench.sdo[0x1018][4].raw == 4711


@pytest.mark.parametrize(("cycles", "resolution", "revolutions"), [
    (1, 8192, 65535), (8, 65536, 65535), (16, 131072, 32767), (2500, 20480000, 209), (524288, 2**31, 1),
    (1048576, 2**31, 1), (1048575, 1048575 * 4096, 1),
])  # fmt: skip
def test_resolution_and_revolutions(cycles: int, resolution: int, revolutions: int) -> None:
    bench = Bench(cycles_per_revolution=cycles)
    assert bench.sdo[0x6501].raw == resolution
    assert bench.sdo[0x6502].raw == revolutions
    assert bench.sdo[0x6002].raw == resolution * revolutions  # where it wraps without scaling, too
