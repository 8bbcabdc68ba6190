from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from device_kit import ID, OK
from hypothesis import given
from hypothesis import strategies as st
from storing_bench import (
    ALL,
    APPLICATION,
    COMMUNICATION,
    LOAD,
    MANUFACTURER,
    RESET_COMMUNICATION,
    RESET_NODE,
    SAVE,
    VERIFY,
    StoringBench,
    write_eds,
)

from canfb.cia301.codes import AbortCode
from canfb.device.storage.image import ParameterGroup
from canfb.device.storage.storage import MemoryStore

EACH = (ALL, COMMUNICATION, APPLICATION, MANUFACTURER)


@pytest.fixture(scope="session")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_eds(tmp_path_factory.mktemp("eds") / "storing.eds")


@pytest.fixture
def store() -> MemoryStore:
    return MemoryStore()


@pytest.fixture
def power_on(path: Path, store: MemoryStore) -> Callable[..., StoringBench]:
    """A new device with this store."""

    def make(node_id: int = ID) -> StoringBench:
        bench = StoringBench(path, store, node_id)
        bench.start()
        return bench

    return make


class BrokenStore(MemoryStore):
    """Gives what it has; saving fails."""

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


# 1010h and 1011h as SDO sees them.


def test_without_a_store_it_says_so_and_the_defaults_come_with_a_reset(path: Path) -> None:
    bench = StoringBench(path, None)
    bench.start()
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
    bench.start()
    change(bench)
    assert bench.save() is AbortCode.HARDWARE
    assert bench.read(SAVE, ALL) == 1
    bench.nmt(RESET_NODE)
    assert values(bench) == DEFAULTS
    assert bench.load() == OK  # there is nothing to forget


# What is kept, and what comes back when.


PLACES = {ALL: (0, 1, 2, 3), COMMUNICATION: (0, 3), APPLICATION: (1,), MANUFACTURER: (2,)}
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
def test_what_is_saved_comes_back_and_what_is_not_or_was_forgotten_does_not(
    path: Path, steps: list[tuple[str | int, int]]
) -> None:
    """Each group for itself, after 82h that of communication alone; the date until a change is saved."""
    store = MemoryStore()
    bench = StoringBench(path, store)
    bench.start()
    now = kept = defaults = [*DEFAULTS, 0]
    for number, (what, group) in enumerate(steps, 10):
        places = PLACES[group]
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
                bench.start()
            else:
                bench.nmt(int(what))
            places = PLACES[COMMUNICATION if what == RESET_COMMUNICATION else ALL]
            now = chosen(places, kept, now)
        assert [*values(bench), bench.value(VERIFY, 1)] == now


def test_stored_values_are_checked_and_nothing_acts_on_them(power_on: Callable[..., StoringBench]) -> None:
    bench = power_on()
    change(bench)
    bench.save()
    checked: list[int] = []
    entry = bench.dictionary.entry(0x2025)
    entry.on_check = checked.append
    entry.on_written = lambda: pytest.fail("the reset hook takes the values over")
    bench.nmt(RESET_NODE)
    assert checked == [111]
    assert values(bench) == CHANGED


def test_process_data_history_and_constants_are_not_kept(
    power_on: Callable[..., StoringBench], store: MemoryStore
) -> None:
    bench = power_on()
    assert bench.write(0x2000, 1, 77, 2) == OK  # rww: process data
    bench.node.emergency(0x7300, 0x20, now=0.0)
    bench.dictionary.entry(0x6001).value = 5  # ro
    bench.save()
    bench = power_on()
    assert bench.value(0x2000, 1) == 0
    assert bench.value(0x1003, 0) == 0
    assert bench.value(0x6001) == 0


def test_every_type_comes_back(power_on: Callable[..., StoringBench]) -> None:
    entries = {
        0x2020: b"\x01\x02\x03" * 100,
        0x2021: "another text",
        0x2023: 2.25,
        0x2024: b"\x00\xff",
        0x2026: 2**63 + 1,
        0x2027: -9,
        0x2028: False,
    }
    bench = power_on()
    for index, value in entries.items():
        bench.dictionary.entry(index).value = value
    bench.save()
    bench = power_on()
    assert {index: bench.value(index) for index in entries} == entries


# COB-IDs and PDOs.


def test_cob_ids_follow_the_node_id_unless_they_were_set(power_on: Callable[..., StoringBench]) -> None:
    bench = power_on()
    assert bench.write(0x1401, 1, 0x320, 4) == OK  # the default, made valid
    assert bench.write(0x1801, 1, 0x800002A0, 4) == OK
    assert bench.write(0x1801, 1, 0x800001F0, 4) == OK  # another CAN-ID
    assert bench.write(0x1400, 1, 0x80000190, 4) == OK  # never had the node-ID in it
    bench.save()
    assert bench.value(0x1014) == 0xA0
    other = power_on(33)
    assert other.value(0x1401, 1) == 0x321
    assert other.value(0x1801, 1) == 0x800001F0
    assert other.value(0x1400, 1) == 0x80000190
    assert other.value(0x1800, 1) == 0x400001A1
    assert other.value(0x1014) == 0xA1
    assert other.faults == []


def test_heartbeat_consumers_may_change_places(power_on: Callable[..., StoringBench]) -> None:
    bench = power_on()
    for value, sub in ((0x000A0064, 1), (0x000B0064, 2)):
        assert bench.write(0x1016, sub, value, 4) == OK
    bench.save()
    for value, sub in ((0, 1), (0x000A0064, 2), (0x000B0064, 1)):
        assert bench.write(0x1016, sub, value, 4) == OK
    bench.save()
    bench.nmt(RESET_NODE)
    assert bench.faults == []
    assert (bench.value(0x1016, 1), bench.value(0x1016, 2)) == (0x000B0064, 0x000A0064)


def test_a_further_sdo_channel_comes_back_or_not(power_on: Callable[..., StoringBench]) -> None:
    bench = power_on()
    bench.write(0x1201, 1, 0x640 + 0x80, 4)
    bench.write(0x1201, 2, 0x6C1, 4)
    bench.nmt(RESET_COMMUNICATION)
    assert bench.value(0x1201, 1) == 0x80000000
    bench.write(0x1201, 1, 0x6C0, 4)
    bench.write(0x1201, 2, 0x6C1, 4)
    bench.save()
    bench.nmt(RESET_COMMUNICATION)
    assert (bench.value(0x1201, 1), bench.value(0x1201, 2)) == (0x6C0, 0x6C1)
    assert bench.send(0x6C0, "4017100000000000") == ["6C1#4B17100000000000"]
