"""The LSS slave by its frames (CiA 305); any frames are in tests/tools/test_fuzz.py."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from device_kit import RESET_COMMUNICATION, StoringBench, hexes, write_eds

from canfb.cia301.codes import NmtState
from canfb.cia301.frame import Frame
from canfb.device.lss import LssState
from canfb.device.storage.kept import ParameterGroup
from canfb.device.storage.storage import MemoryStore

ADDRESS = (0x11223344, 0x55667788, 0x00010002, 0xDEADBEEF)
NONE = 255


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_eds(tmp_path_factory.mktemp("eds") / "lss.eds", ADDRESS)


class LssBench(StoringBench):
    """The device, and an LSS master that sends frames and hears the answers."""

    def __init__(self, path: Path, node_id: int = 32, store: MemoryStore | None = None) -> None:
        super().__init__(path, store, node_id, bit_rates_kbit_s=(125, 500))

    @property
    def activated(self) -> list[tuple[int, float, float]]:
        return self.application.told("bit_rate_activated")

    def lss(self, command: int, *rest: int) -> list[str]:
        """The answers, without their CAN-ID and trailing zero bytes."""
        data = bytes([command, *rest]).ljust(8, b"\x00")
        answers = self.node.receive(Frame(0x7E5, data), self.now)
        assert all(len(frame.data) == 8 for frame in answers if frame.can_id == 0x7E4)
        return [text.removeprefix("7E4#").rstrip("0") for text in hexes(answers)]

    def part(self, command: int, number: int) -> list[str]:
        return self.lss(command, *number.to_bytes(4, "little"))

    def select(self, address: tuple[int, ...] = ADDRESS) -> list[str]:
        return [text for n, number in enumerate(address) for text in self.part(0x40 + n, number)]

    def identify(self, *numbers: int) -> list[str]:
        return [text for n, number in enumerate(numbers) for text in self.part(0x46 + n, number)]

    def configure(self) -> LssBench:
        assert self.lss(0x04, 1) == []
        return self


@pytest.fixture
def make(path: Path) -> Callable[..., LssBench]:
    return partial(LssBench, path)


@pytest.fixture
def bench(make: Callable[..., LssBench]) -> LssBench:
    return make()


@pytest.mark.parametrize("wrong", range(4))
def test_another_address_selects_nobody(bench: LssBench, wrong: int) -> None:
    address = [number ^ (1 << 31 if n == wrong else 0) for n, number in enumerate(ADDRESS)]
    assert bench.select(tuple(address)) == bench.select(ADDRESS[1:] + ADDRESS[:1]) == []
    assert [bench.part(0x40 + n, part) for n, part in zip((0, 1, 1, 3), ADDRESS, strict=True)] == [[]] * 4
    assert bench.node.lss.state is LssState.WAITING
    assert bench.part(0x43, ADDRESS[3]) == []  # three parts are missing
    assert bench.select() == ["44"]
    assert bench.select() == []  # it is selected already


CONFIGURATION = [(LssState.CONFIGURATION, node) for node in (32, NONE)]
WAITING = [(LssState.WAITING, node) for node in (32, NONE)]
TABLE: list[tuple[tuple[int, ...], list[tuple[LssState, int]], str]] = [
    ((0x5A,), CONFIGURATION, "5A44332211"),
    ((0x5B,), CONFIGURATION, "5B88776655"),
    ((0x5C,), CONFIGURATION, "5C020001"),
    ((0x5D,), CONFIGURATION, "5DEFBEADDE"),
    ((0x5E,), CONFIGURATION[:1], "5E2"),
    ((0x5E,), CONFIGURATION[1:], "5EFF"),
    ((0x11, 40), CONFIGURATION, "11"),
    *(((0x11, node_id), CONFIGURATION, "1101") for node_id in (0, 128, 200, 254)),
    ((0x13, 0, 2), CONFIGURATION, "13"),
    ((0x13, 0, 1), CONFIGURATION, "1301"),
    ((0x13, 1, 2), CONFIGURATION, "1301"),
    ((0x17,), CONFIGURATION, "1701"),
    ((0x4C,), [(state, NONE) for state in LssState], "5"),
    ((0x51, 0, 0, 0, 0, 128), WAITING[1:], "4F"),
    *(((command, *bytes(4), 128), [], "") for command in (0x00, 0x04, 0x15, 0x43, 0x4B, 0x5F, 0xFF)),
]


@pytest.mark.parametrize("frame", sorted({frame for frame, _, _ in TABLE}))
@pytest.mark.parametrize("where", [(state, node) for state in LssState for node in (32, NONE)])
def test_every_service_in_every_state(
    make: Callable[..., LssBench], where: tuple[LssState, int], frame: tuple[int, ...]
) -> None:
    state, node = where
    bench = make(node)
    assert bench.lss(0x04, state) == []
    expected = [answer for given, places, answer in TABLE if given == frame and where in places]
    assert bench.lss(*frame) == expected


def test_identify_remote_slave(bench: LssBench) -> None:
    vendor, product, revision, serial = ADDRESS
    assert bench.identify(vendor, product, revision, revision, serial, serial) == ["4F"]
    assert bench.identify(vendor, product, 0, 0xFFFFFFFF, 0, 0xFFFFFFFF) == ["4F"]
    assert bench.identify(vendor, product, revision + 1, 0xFFFFFFFF, 0, 0xFFFFFFFF) == []
    assert bench.identify(vendor, product, 0, revision - 1, 0, 0xFFFFFFFF) == []
    assert bench.identify(vendor, product, 0, revision, serial + 1, 0xFFFFFFFF) == []
    assert bench.identify(vendor, product, 0, revision, 0, serial - 1) == []
    assert bench.identify(vendor + 1, product, 0, revision, 0, serial) == []
    assert bench.identify(vendor, product + 1, 0, revision, 0, serial) == []
    bench.configure()
    assert bench.identify(vendor, product, 0, revision, 0, serial) == ["4F"]


def test_a_node_id_is_in_force_after_reset_communication(bench: LssBench) -> None:
    assert bench.lss(0x11, 40) == []
    assert bench.configure().lss(0x11, 40) + bench.lss(0x11, 200) == ["11", "1101"]
    assert bench.lss(0x5E) == ["5E2"]
    assert bench.lss(0x04, 0) == []
    assert bench.read(0x1014) == 0xA0
    assert bench.nmt(RESET_COMMUNICATION) == ["728#00"]
    assert bench.node.node_id == 40
    assert bench.nmt(RESET_COMMUNICATION) == []  # 32 is somebody else now
    assert bench.send(0x620, "4000100000000000") == []
    assert bench.send(0x628, "4014100000000000") == ["5A8#43141000A8000000"]
    assert bench.value(0x1800, 1) == 0x400001A8
    assert bench.value(0x1400, 1) == 0x190
    assert bench.send(0x728, rtr=True) == ["728#7F"]
    assert bench.nmt(1, 40) == []
    assert bench.node.state is NmtState.OPERATIONAL


def test_without_a_node_id_there_is_lss_and_nothing_else(make: Callable[..., LssBench]) -> None:
    bench = make(NONE)
    assert (bench.first, bench.node.state, bench.node.deadline()) == ([], NmtState.INITIALISING, None)
    for can_id in set(range(0x800)) - {0x7E5}:
        for data in (b"\x01\x00", b"\x82\x00", b"\x81\xff", b"", bytes(8)):
            assert bench.send(can_id, data) == []
        assert bench.send(can_id, rtr=True) == []
    assert bench.node.state is NmtState.INITIALISING
    assert (bench.node.own_can_ids, bench.node.counters.duplicate_frames) == (frozenset(), 0)
    bench.node.emergency(0x7300, 0x20, now=0.0)
    assert bench.node.bus_off(1.0) == bench.node.bus_back(2.0) == bench.run(10.0) == []
    assert bench.configure().lss(0x5E) == ["5EFF"]


def test_it_boots_when_it_has_got_one_and_waits_again(make: Callable[..., LssBench]) -> None:
    bench = make(NONE)
    assert bench.lss(0x04, 0) == []
    assert bench.configure().lss(0x04, 0) == []  # still none
    assert bench.node.state is NmtState.INITIALISING
    assert bench.configure().lss(0x11, 32) == ["11"]
    assert bench.lss(0x04, 2) + bench.lss(0x5E) == ["5EFF"]  # there is no state 2
    assert bench.lss(0x04, 0) == ["720#"]  # the boot-up
    assert bench.node.state is NmtState.PRE_OPERATIONAL
    assert (bench.read(0x1014), bench.value(0x1800, 1)) == (0xA0, 0x400001A0)
    assert bench.lss(0x4C) == []


def test_a_node_id_can_be_taken_away(make: Callable[..., LssBench]) -> None:
    bench = make(32)
    bench.write(0x1017, 0, 100, 2)
    bench.nmt(1)
    assert bench.configure().lss(0x11, NONE) == ["11"]
    assert bench.nmt(RESET_COMMUNICATION) == []
    assert bench.node.state is NmtState.INITIALISING
    assert bench.run(1.0) == []
    assert bench.lss(0x4C) == ["5"]
    bench.configure().lss(0x11, 33)
    assert bench.lss(0x04, 0) == ["721#"]
    assert bench.value(0x1014) == 0xA1


def fastscan(bench: LssBench, number: int, bit: int, part: int, following: int) -> list[str]:
    return bench.lss(0x51, *number.to_bytes(4, "little"), bit, part, following)


def test_fastscan_finds_the_address_bit_by_bit(make: Callable[..., LssBench]) -> None:
    bench = make(NONE)
    assert fastscan(bench, 0, 128, 0, 0) == ["4F"]
    for part, wanted in enumerate(ADDRESS):
        found = 0
        for bit in range(31, -1, -1):
            if fastscan(bench, found, bit, part, part) == []:
                found |= 1 << bit
        assert found == wanted
        assert bench.node.lss.state is LssState.WAITING
        assert fastscan(bench, found, 0, part, (part + 1) % 4) == ["4F"]
    assert bench.node.lss.state is LssState.CONFIGURATION
    assert fastscan(bench, 0, 128, 0, 0) == []  # it has been found


def test_an_impossible_part_or_one_out_of_turn_is_not_answered(make: Callable[..., LssBench]) -> None:
    bench = make(NONE)
    fastscan(bench, 0, 128, 0, 0)
    for impossible in ((32, 0, 0), (127, 0, 0), (0, 4, 0), (0, 0, 4)):
        assert fastscan(bench, ADDRESS[0], *impossible) == []
    assert fastscan(bench, ADDRESS[1], 0, 1, 1) == []
    assert fastscan(bench, ADDRESS[0], 0, 0, 1) == ["4F"]
    assert fastscan(bench, ADDRESS[1], 0, 1, 1) == ["4F"]
    assert fastscan(bench, 0, 128, 0, 0) == ["4F"]  # begins anew
    assert fastscan(bench, ADDRESS[1], 0, 1, 1) == []


def test_activation_is_told_with_the_delay(bench: LssBench) -> None:
    bench.configure()
    assert bench.lss(0x15, 0xE8, 0x03) == []
    assert bench.activated == []  # nothing was configured
    assert bench.lss(0x13, 0, 2) + bench.lss(0x13, 0, 5) == ["13", "1301"]
    bench.now = 5.0
    assert bench.lss(0x15, 0xE8, 0x03) == []
    assert bench.activated == [(500, 1.0, 5.0)]
    bench.lss(0x04, 0)
    assert bench.lss(0x15, 0xE8, 0x03) == []
    assert len(bench.activated) == 1


def test_parameters_follow_the_stored_node_id_and_load_does_not_take_it_away(
    make: Callable[..., LssBench],
) -> None:
    store = MemoryStore()
    bench = make(32, store)
    bench.write(0x1017, 0, 500, 2)
    bench.save()
    bench.configure().lss(0x11, 40)
    bench.lss(0x13, 0, 4)
    bench.lss(0x17)
    bench.nmt(RESET_COMMUNICATION)
    for device in (bench, make(32, store)):
        assert device.node.lss.bit_rate_kbit_s == 125
        assert device.value(0x1017) == 500
        assert device.value(0x1800, 1) == 0x400001A8
    again = make(NONE, store)
    again.send(0x628, struct.pack("<BHB4s", 0x23, 0x1011, 1, b"load"))
    assert set(store.images) == {ParameterGroup.LSS}


@pytest.mark.parametrize("damage", ["not an image", "no node-ID"])
def test_a_stored_node_id_that_is_none_is_refused(make: Callable[..., LssBench], damage: str) -> None:
    store = MemoryStore()
    bench = make(32, store)
    bench.node.lss.pending_node_id = 0
    bench.configure().lss(0x17)
    if damage == "not an image":
        store.images[ParameterGroup.LSS] = b"?"
    again = make(32, store)
    assert again.first == ["720#00"]
    assert list(again.node.storage.faults) == [ParameterGroup.LSS]
    again.faults.clear()
    assert again.configure().lss(0x17) == ["17"]
    assert again.faults == [{}]
