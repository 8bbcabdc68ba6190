"""Parameters that are saved: what comes back when, and none of a group that must not; any may be, whole."""

import struct
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
from device_kit import (
    ALL,
    APPLICATION,
    COMMUNICATION,
    LOAD,
    MANUFACTURER,
    OK,
    RESET_COMMUNICATION,
    RESET_NODE,
    SAVE,
    VERIFY,
    StoringBench,
    write_eds,
)
from hypothesis import example, given, strategies as st

from canfb.cia301.codes import AbortCode
from canfb.device.storage.kept import Identity, ImageError, ParameterGroup, Record, decode_image, encode_image
from canfb.device.storage.storage import MemoryStore
from drawing import examples

EACH = (ALL, COMMUNICATION, APPLICATION, MANUFACTURER)


@pytest.fixture(scope="session")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_eds(tmp_path_factory.mktemp("eds") / "storing.eds")


class BrokenStore(MemoryStore):
    def save(self, changes: Mapping[ParameterGroup, bytes | None]) -> None:
        raise OSError(28, "No space left on device")


PARAMETERS = [(0x1017, 2), (0x6000, 2), (0x2025, 1)]
"""Index and bytes of one of each group: communication, application, manufacturer."""
DEFAULTS = [0, -7, 0]
CHANGED = [500, 1234, 111]


def change(bench: StoringBench) -> None:
    for (index, size), value in zip(PARAMETERS, CHANGED, strict=True):
        assert bench.write(index, 0, value, size) == OK


def values(bench: StoringBench) -> list[object]:
    return [bench.value(index) for index, _ in PARAMETERS]


def test_without_a_store_it_says_so_and_the_defaults_come_with_a_reset(path: Path) -> None:
    bench = StoringBench(path, None)
    change(bench)
    for subindex in EACH:
        assert bench.read(SAVE, subindex) == 0
        assert bench.save(subindex) is AbortCode.NOT_STORED
        assert bench.read(LOAD, subindex) == 1
        assert bench.load(subindex) == OK
    assert values(bench) == CHANGED
    bench.nmt(RESET_NODE)
    assert values(bench) == DEFAULTS


def test_a_store_that_fails_is_a_hardware_error_and_changes_nothing(path: Path) -> None:
    store = BrokenStore()
    bench = StoringBench(path, store)
    change(bench)
    assert (bench.save(), bench.read(SAVE, ALL)) == (AbortCode.HARDWARE, 1)
    bench.nmt(RESET_NODE)
    assert values(bench) == DEFAULTS
    assert bench.load() == OK  # there is nothing to forget


PLACES_OF = {ALL: (0, 1, 2, 3), COMMUNICATION: (0, 3), APPLICATION: (1,), MANUFACTURER: (2,)}
"""Of the parameters of a group in what is read; the last is the date of the configuration, 1020h."""
STEPS = st.lists(
    st.tuples(
        st.sampled_from(["write", "date", "save", "load", "power", RESET_NODE, RESET_COMMUNICATION]),
        st.sampled_from(EACH),
    ),
    max_size=15,
)


def chosen(places: tuple[int, ...], there: list[int], elsewhere: list[int]) -> list[int]:
    return [there[place] if place in places else elsewhere[place] for place in range(len(there))]


@given(STEPS)
@example([("write", ALL), (RESET_COMMUNICATION, ALL)])
@example([("save", ALL), ("write", ALL), (RESET_COMMUNICATION, ALL)])
def test_what_is_saved_comes_back_and_what_is_not_or_was_forgotten_does_not(
    path: Path, steps: list[tuple[str | int, int]]
) -> None:
    """Each group for itself, after 82h that of communication alone; the date until a change is saved."""
    store = MemoryStore()
    bench = StoringBench(path, store)
    now = kept = defaults = [*DEFAULTS, 0]
    for number, (what, group) in enumerate(steps, 10):
        places = PLACES_OF[group]
        if what == "write":
            for place in set(places) - {3}:
                index, size = PARAMETERS[place]
                assert bench.write(index, 0, number, size) == OK
            now = [*chosen(places, [number] * 3, now), 0]
        elif what == "date":
            assert bench.write(VERIFY, 1, number, 4) == OK
            now = [*now[:3], number]
            assert bench.write(0x2000, 1, 5, 2) == OK, "process data change no configuration"
            assert bench.write(0x2025, 0, 201, 1) is AbortCode.VALUE_TOO_HIGH
        elif what == "save":
            assert bench.save(group) == OK
            kept = chosen(places, now, kept)
        elif what == "load":
            assert bench.load(group) == OK
            kept = chosen(places, defaults, kept)
            now = [*now[:3], 0]
        else:
            if what == "power":
                bench = StoringBench(path, store)
            else:
                bench.nmt(int(what))
            places = PLACES_OF[COMMUNICATION if what == RESET_COMMUNICATION else ALL]
            now = chosen(places, kept, now)
        assert [*values(bench), bench.value(VERIFY, 1)] == now


GROUP = ParameterGroup.COMMUNICATION
IDENTITY = Identity(0, 0, 0)  # that of the sample device, whose 1018h has a vendor-ID alone


def all_values(bench: StoringBench) -> dict[tuple[int, int], object]:
    return {(entry.index, entry.subindex): entry.value for entry in bench.dictionary}


def powered(path: Path, image: bytes | None) -> StoringBench:
    store = MemoryStore()
    if image is not None:
        store.images[GROUP] = image
    bench = StoringBench(path, store)
    assert bench.first[0] == "720#00"
    return bench


@pytest.fixture
def saved(path: Path) -> MemoryStore:
    store = MemoryStore()
    bench = StoringBench(path, store)
    assert bench.write(0x1017, 0, 500, 2) == OK
    assert bench.write(0x2025, 0, 50, 1) == OK
    assert bench.save() == OK
    return store


def is_refused(path: Path, image: bytes, reason: str = "") -> bool:
    bench = powered(path, image)
    if all_values(bench) != all_values(powered(path, None)):
        return False
    (faults,) = bench.faults
    assert list(faults) == [GROUP]
    assert reason in faults[GROUP]
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


def test_a_save_drops_no_group_that_has_no_parameters(path: Path) -> None:
    bench = StoringBench(path, MemoryStore())
    bench.node.storage.entries.leave_out(0x6000)
    assert bench.save() == OK
    assert bench.application.told("parameters_saved")[-1][:2] == ([COMMUNICATION, MANUFACTURER], [])


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


def refused_images(saved: MemoryStore) -> Iterator[tuple[bytes, str]]:
    """Damaged, of others, or with a value that SDO could not write; and what is said of each."""
    body = saved.images[GROUP][:-4]
    yield with_crc(changed(body, 8, 1)), "format version 2: only 1 is supported"
    yield with_crc(changed(body, 24, 1)), "do not match the header"
    yield with_crc(body[:-1]), "truncated"
    yield with_crc(body + b"\0"), "truncated"
    yield body + bytes(3), "the CRC is wrong"
    yield b"", "truncated"
    yield saved.images[ParameterGroup.MANUFACTURER], "those of group 4"
    for identity in ((1, 0, 0), (0, 1, 0), (0, 0, 0x10000)):
        yield encode_image(GROUP, Identity(*identity), records(saved)), "saved by another device"
    for wrong, reason in WRONG.values():
        others = [r for r in records(saved) if (r.index, r.subindex) != (wrong.index, wrong.subindex)]
        yield encode_image(GROUP, IDENTITY, [*others, wrong]), reason


def test_an_image_that_must_not_be_used_is_refused_whole(path: Path, saved: MemoryStore) -> None:
    for image, reason in refused_images(saved):
        assert is_refused(path, image, reason), reason


def test_a_value_beyond_its_limits_refuses_its_group_and_no_other(path: Path, saved: MemoryStore) -> None:
    wrong = [Record(0x2025, 0, False, b"\xc9"), Record(0x2026, 0, False, bytes(8))]
    saved.images[ParameterGroup.MANUFACTURER] = encode_image(ParameterGroup.MANUFACTURER, IDENTITY, wrong)
    bench = StoringBench(path, saved)
    assert bench.faults == [{MANUFACTURER: "2025h:00: 06090031h value of parameter written too high"}]
    assert bench.value(0x2025) == 0
    assert bench.value(0x1017) == 500


def test_an_image_with_fewer_entries_leaves_the_others_alone(path: Path) -> None:
    image = encode_image(GROUP, IDENTITY, [Record(0x1017, 0, False, b"\x64\x00")])
    bench = powered(path, image)
    assert bench.faults == []
    before = all_values(powered(path, None))
    assert all_values(bench) == before | {(0x1017, 0): 100}


@pytest.mark.parametrize("whole", [False, True])
def test_a_store_that_cannot_be_read_is_a_fault(path: Path, saved: MemoryStore, whole: bool) -> None:
    error = OSError(5, "Input/output error")

    class Unreadable(MemoryStore):
        def load(self) -> dict[ParameterGroup, bytes | OSError]:
            if whole:
                raise error
            return {**saved.images, GROUP: error}

    bench = StoringBench(path, Unreadable())
    assert bench.first[0] == "720#00"
    (faults,) = bench.faults
    assert set(faults.values()) == {"cannot be read: Input/output error"}
    assert len(faults) == (3 if whole else 1)
    assert bench.value(0x2025) == (0 if whole else 50)
    assert bench.save() == OK
    assert bench.faults[1:] == [{}]


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


EVERY_TYPE: dict[int, object] = {
    0x2020: b"\x01\x02\x03" * 100,
    0x2021: "another text",
    0x2023: 2.25,
    0x2024: b"\x00\xff",
    0x2026: 2**63 + 1,
    0x2027: -9,
    0x2028: False,
}
WRITES = st.lists(st.tuples(places, numbers), max_size=40)
CONSUMERS = [((0x1016, 1), 0x000A0064), ((0x1016, 2), 0x000B0064)]
CHANGED_PLACES = [((0x1016, 1), 0), ((0x1016, 2), 0x000A0064), ((0x1016, 1), 0x000B0064)]
SECOND_CHANNEL = [((0x1201, 1), 0x6C0), ((0x1201, 2), 0x6C1)]


def write_all(bench: StoringBench, writes: list[tuple[tuple[int, int], int]]) -> None:
    for (index, subindex), number in writes:
        size = bench.dictionary.entry(index, subindex).byte_length
        bench.write(index, subindex, number & (1 << 8 * size) - 1, size)


@examples(150)
@given(WRITES, WRITES)
@example(CONSUMERS, CHANGED_PLACES)
@example(SECOND_CHANNEL, [((0x1201, 1), 0x800006C0)])
def test_what_a_master_could_write_can_be_restored(
    path: Path, writes: list[tuple[tuple[int, int], int]], later: list[tuple[tuple[int, int], int]]
) -> None:
    """After a power-off, and at a reset of the node, whatever it has held since."""
    store = MemoryStore()
    bench = StoringBench(path, store)
    for index, value in EVERY_TYPE.items():
        bench.dictionary.entry(index).value = value
    write_all(bench, writes)
    assert bench.save() == OK
    saved, answers = all_values(bench), bench.send(0x6C0, "4017100000000000")
    write_all(bench, later)
    bench.nmt(RESET_NODE)
    for restored in (bench, StoringBench(path, store)):
        assert restored.faults == []
        kept = all_values(restored)
        assert kept == saved | {place: kept[place] for place in ((0x1010, 1), (0x1001, 0))}
        assert restored.send(0x6C0, "4017100000000000") == answers
