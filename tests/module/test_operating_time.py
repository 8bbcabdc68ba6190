"""Object 6508h: hours over all starts, and what a failing disk makes of them."""

from __future__ import annotations

import errno
from collections.abc import Mapping

import pytest
from canopen import RemoteNode
from module_bench import Bench

from canfb.cia301.frame import Frame
from canfb.device.storage.image import ParameterGroup
from canfb.device.storage.storage import MemoryStore
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig

HOUR_S = 3600.0
GROUP = ParameterGroup.OPERATING_TIME


class Module:
    """A module that is read at chosen times."""

    def __init__(self, store: MemoryStore, start_s: float = 0.0) -> None:
        self.module = FeedbackModule(ModuleConfig(node_id=32), store)
        self.start_frames = self.module.start(start_s)

    def nmt(self, command: int, now: float) -> None:
        self.module.receive(Frame(0, bytes([command, 32])), now)

    def read(self, now: float) -> int:
        (answer,) = self.module.receive(Frame(0x620, bytes.fromhex("4008650000000000")), now)
        assert answer.data[:4] == bytes.fromhex("43086500")
        return int.from_bytes(answer.data[4:], "little")


def test_without_a_store_nothing_is_counted(bench: Bench) -> None:
    remote: RemoteNode = bench.remote
    assert remote.sdo[0x6508].raw == 0xFFFFFFFF
    bench.module.end(9 * HOUR_S)


def test_it_counts_tenths_of_an_hour_in_every_state() -> None:
    module = Module(MemoryStore(), 1000.0)
    assert module.read(1000.0) == module.read(1359.9) == 0
    assert module.read(1360.0) == 1
    module.nmt(1, 1400.0)
    module.nmt(129, 1500.0)  # a reset is no start
    assert module.read(1000.0 + 10 * HOUR_S) == 100


@pytest.mark.parametrize("way", ["end", "stop", "pre-operational", "reset"])
def test_it_goes_on_in_the_next_process(way: str) -> None:
    store = MemoryStore()
    first = Module(store)
    first.nmt(1, 1.0)
    if way == "end":
        first.module.end(2 * HOUR_S)
    else:
        first.nmt({"stop": 2, "pre-operational": 128, "reset": 129}[way], 2 * HOUR_S)
    second = Module(store, 5e6)
    assert second.read(5e6) == 20
    second.module.end(5e6 + HOUR_S)
    assert Module(store).read(0.0) == 30


def test_a_load_of_defaults_leaves_it_alone() -> None:
    store = MemoryStore()
    module = Module(store)
    module.module.end(HOUR_S)
    module.module.receive(Frame(0x620, bytes.fromhex("231110016C6F6164")), HOUR_S)
    module.nmt(129, HOUR_S)
    assert module.read(HOUR_S) == Module(store).read(0.0) == 10


class FullDisk(MemoryStore):
    full = True

    def save(self, changes: Mapping[ParameterGroup, bytes | None]) -> None:
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")
        super().save(changes)


def test_a_full_disk_loses_nothing_that_can_be_written_later() -> None:
    store = FullDisk()
    module = Module(store)
    module.module.end(HOUR_S)
    store.full = False
    module.module.end(HOUR_S)
    assert Module(store).read(0.0) == 10


def test_a_damaged_time_is_told_and_counts_anew() -> None:
    store = MemoryStore()
    Module(store).module.end(HOUR_S)
    store.images[GROUP] = store.images[GROUP][:-1]
    module = Module(store)
    told = [frame.data[:4].hex() for frame in module.start_frames if frame.can_id == 0xA0]
    assert told == ["10632181"]  # EMCY 6310h, group 81h
    assert module.read(0.0) == 0
    module.module.end(HOUR_S)
    assert module.module.dictionary.entry(0x6503).value == 0
    assert Module(store).read(0.0) == 10
