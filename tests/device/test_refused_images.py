"""Stored parameters that must not be used, and any that may: whole or not at all."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
from device_kit import OK
from hypothesis import given
from hypothesis import strategies as st
from storing_bench import COMMUNICATION, MANUFACTURER, RESET_NODE, StoringBench, write_eds

from canfb.device.storage.image import (
    Identity,
    ImageError,
    ParameterGroup,
    Record,
    decode_image,
    encode_image,
)
from canfb.device.storage.storage import MemoryStore
from drawing import examples

GROUP = ParameterGroup.COMMUNICATION
IDENTITY = Identity(0, 0, 0)  # that of the sample device, whose 1018h has a vendor-ID alone


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_eds(tmp_path_factory.mktemp("eds") / "storing.eds")


def values(bench: StoringBench) -> dict[tuple[int, int], object]:
    return {(entry.index, entry.subindex): entry.value for entry in bench.dictionary}


def powered(path: Path, image: bytes | None, group: ParameterGroup = GROUP) -> StoringBench:
    store = MemoryStore()
    if image is not None:
        store.images[group] = image
    bench = StoringBench(path, store)
    assert bench.start()[0] == "720#00"
    return bench


@pytest.fixture
def saved(path: Path) -> MemoryStore:
    store = MemoryStore()
    bench = StoringBench(path, store)
    bench.start()
    assert bench.write(0x1017, 0, 500, 2) == OK
    assert bench.write(0x2025, 0, 50, 1) == OK
    assert bench.save() == OK
    return store


def is_refused(path: Path, image: bytes, reason: str = "", group: ParameterGroup = GROUP) -> bool:
    bench = powered(path, image, group)
    if values(bench) != values(powered(path, None)):
        return False
    (faults,) = bench.faults
    assert list(faults) == [group]
    assert reason in faults[group]
    return True


def records(saved: MemoryStore, group: ParameterGroup = GROUP) -> list[Record]:
    return decode_image(saved.images[group], group, IDENTITY)


def with_crc(body: bytes) -> bytes:
    return body + struct.pack("<I", zlib.crc32(body))


def test_every_cut_and_every_flipped_bit_is_refused(saved: MemoryStore) -> None:
    for group in (GROUP, ParameterGroup.APPLICATION):
        image = saved.images[group]
        damaged = [image[:length] for length in range(len(image))]
        for place in range(8 * len(image)):
            flipped = bytearray(image)
            flipped[place // 8] ^= 1 << place % 8
            damaged.append(bytes(flipped))
        for one in damaged:
            with pytest.raises(ImageError):
                decode_image(one, group, IDENTITY)


def changed(body: bytes, place: int, more: int) -> bytes:
    return body[:place] + bytes([body[place] + more]) + body[place + 1 :]


BODIES: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "another format": (lambda body: with_crc(changed(body, 8, 1)), "format version 2: only 1 is supported"),
    "a record too many": (
        lambda body: with_crc(changed(body, 24, 1)),
        "do not match the header",
    ),
    "a byte too few": (lambda body: with_crc(body[:-1]), "truncated"),
    "a byte too many": (lambda body: with_crc(body + b"\0"), "truncated"),
    "another CRC": (lambda body: body + bytes(3), "the CRC is wrong"),
    "nothing": (lambda body: b"", "truncated"),
}


@pytest.mark.parametrize("name", BODIES)
def test_a_body_that_is_not_what_the_header_says_is_refused(
    path: Path, saved: MemoryStore, name: str
) -> None:
    change, reason = BODIES[name]
    assert is_refused(path, change(saved.images[GROUP][:-4]), reason)


def test_another_group_is_refused(path: Path, saved: MemoryStore) -> None:
    assert is_refused(path, saved.images[ParameterGroup.MANUFACTURER], "those of group 4")


@pytest.mark.parametrize("identity", [(1, 0, 0), (0, 1, 0), (0, 0, 0x10000)])
def test_another_device_is_refused(path: Path, saved: MemoryStore, identity: tuple[int, int, int]) -> None:
    image = encode_image(GROUP, Identity(*identity), records(saved))
    assert is_refused(path, image, "saved by another device")


def test_a_minor_revision_makes_no_other_device(path: Path, saved: MemoryStore) -> None:
    bench = powered(path, encode_image(GROUP, Identity(0, 0, 0xFFFF), records(saved)))
    assert bench.value(0x1017) == 500


WRONG = {
    "no such object": (Record(0x1FFF, 0, False, b"\x00"), "1FFFh:00 is not a parameter"),
    "another group": (Record(0x2025, 0, False, b"\x05"), "2025h:00 is not a parameter"),
    "read only": (Record(0x1018, 1, False, bytes(4)), "1018h:01 is not a parameter"),
    "a command": (Record(0x1010, 1, False, bytes(4)), "1010h:01 is not a parameter"),
    "too long": (Record(0x1017, 0, False, bytes(3)), "1017h:00: 06070012h"),
    "too short": (Record(0x1017, 0, False, b"\x00"), "1017h:00: 06070013h"),
    "relative and short": (Record(0x1017, 0, True, b"\x00"), "1017h:00: 06070013h"),
    "refused by SDO": (Record(0x1029, 1, False, b"\x03"), "1029h:01: 06090030h"),
    "a restricted CAN-ID": (Record(0x1801, 1, False, b"\x81\x05\x00\x00"), "1801h:01: 06090030h"),
    "an impossible counter": (Record(0x1019, 0, False, b"\x01"), "1019h:00: 06090030h"),
    "a mapping without object": (Record(0x1A00, 1, False, struct.pack("<I", 0x30000008)), "06020000h"),
    "a mapping of too many bits": (Record(0x1A00, 1, False, struct.pack("<I", 0x20100540)), "06040042h"),
    "more objects than mapped": (Record(0x1A00, 0, False, b"\x08"), "06040041h"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_value_that_sdo_could_not_write_refuses_the_whole(
    path: Path, saved: MemoryStore, name: str
) -> None:
    wrong, reason = WRONG[name]
    others = [r for r in records(saved) if (r.index, r.subindex) != (wrong.index, wrong.subindex)]
    image = encode_image(GROUP, IDENTITY, [*others, wrong])
    assert is_refused(path, image, reason)


def test_a_value_beyond_its_limits_refuses_its_group_and_no_other(path: Path, saved: MemoryStore) -> None:
    wrong = [Record(0x2025, 0, False, b"\xc9"), Record(0x2026, 0, False, bytes(8))]
    saved.images[ParameterGroup.MANUFACTURER] = encode_image(ParameterGroup.MANUFACTURER, IDENTITY, wrong)
    bench = StoringBench(path, saved)
    bench.start()
    assert bench.faults == [{MANUFACTURER: "2025h:00: 06090031h value of parameter written too high"}]
    assert bench.value(0x2025) == 0
    assert bench.value(0x1017) == 500


def test_an_image_with_fewer_entries_leaves_the_others_alone(path: Path) -> None:
    image = encode_image(GROUP, IDENTITY, [Record(0x1017, 0, False, b"\x64\x00")])
    bench = powered(path, image)
    assert bench.faults == []
    before = values(powered(path, None))
    assert values(bench) == before | {(0x1017, 0): 100}


# How long a fault lasts.


def test_a_fault_is_told_at_each_reset_until_the_group_is_saved(path: Path, saved: MemoryStore) -> None:
    saved.images[GROUP] = b"?"
    bench = StoringBench(path, saved)
    bench.start()
    bench.nmt(RESET_NODE)
    told = {COMMUNICATION: "no stored parameters, or truncated"}
    assert bench.faults == [told, told]
    bench.save(MANUFACTURER)
    assert bench.faults == [told, told]
    assert bench.save(COMMUNICATION) == OK
    assert bench.faults == [told, told, {}]
    bench.nmt(RESET_NODE)
    assert bench.faults == [told, told, {}]


@pytest.mark.parametrize("whole", [False, True])
def test_a_store_that_cannot_be_read_is_a_fault(path: Path, saved: MemoryStore, whole: bool) -> None:
    error = OSError(5, "Input/output error")

    class Unreadable(MemoryStore):
        def load(self) -> dict[ParameterGroup, bytes | OSError]:
            if whole:
                raise error
            return {**saved.images, GROUP: error}

    bench = StoringBench(path, Unreadable())
    assert bench.start()[0] == "720#00"
    (faults,) = bench.faults
    assert set(faults.values()) == {"cannot be read: Input/output error"}
    assert len(faults) == (3 if whole else 1)
    assert bench.value(0x2025) == (0 if whole else 50)
    assert bench.save() == OK
    assert bench.faults[1:] == [{}]


# Any bytes, any configuration.


@given(st.binary(max_size=200), st.booleans())
def test_any_bytes_are_refused_and_the_device_is_on_the_bus(path: Path, data: bytes, sealed: bool) -> None:
    assert is_refused(path, with_crc(data) if sealed else data)


PLACES = """
1016:1 1016:2 1A00:0 1A00:1 1800:1 1800:2 1800:6 1005:0 1006:0 1019:0 1400:1 1201:1 1201:2 1017:0 1029:1
1600:0 1600:3 2025:0 2027:0 1014:0 1012:0
"""
NUMBERS = """
80 40000080 190 80000190 400001A0 C00001A0 1A0 A0 100 80000100 800000A0 6C0 80000000 000A0064 20100110
20100608 20000110 FFFF FC FD FE FF F0 3E8
"""
places = st.sampled_from([tuple(int(part, 16) for part in text.split(":")) for text in PLACES.split()])
numbers = st.one_of(
    st.integers(0, 8),
    st.sampled_from([int(text, 16) for text in NUMBERS.split()]),
    st.integers(0, 0xFFFFFFFF),
)


@examples(150)
@given(st.lists(st.tuples(places, numbers), max_size=40))
def test_what_a_master_could_write_can_be_restored(
    path: Path, writes: list[tuple[tuple[int, int], int]]
) -> None:
    store = MemoryStore()
    bench = StoringBench(path, store)
    bench.start()
    for (index, subindex), number in writes:
        size = bench.dictionary.entry(index, subindex).byte_length
        bench.write(index, subindex, number & (1 << 8 * size) - 1, size)
    assert bench.save() == OK
    again = StoringBench(path, store)
    again.start()
    assert again.faults == []
    kept = values(again)
    assert kept == values(bench) | {place: kept[place] for place in ((0x1010, 1), (0x1001, 0))}
