"""2040h: what is refused while the module is locked, what is not, and what unlocks it."""

import struct
from typing import Any

import pytest
from module_bench import Bench

from canfb import Frame, objects as od
from canfb.device.storage.storage import MemoryStore
from canfb.module.device_configuration import backup_values, configuration_of

CODE = 0x51F0A7E3
STATE, LOCAL = "08000022", "08000021"
PROCESS_DATA = {f"2000:{sub:02X}" for sub in range(1, 23)}
FREE = PROCESS_DATA | {"1003:00", "2030:0A", "2040:02", "2050:01", "6003:00", "6009:00"}


class Locked(Bench):
    def __init__(self, store: MemoryStore | None = None, **config: Any) -> None:
        super().__init__(store or MemoryStore(), **config)

    def nmt(self, command: int) -> None:
        self.remote.nmt.send_command(command)

    def ask(self, data: bytes) -> str:
        """The abort code of one request, "" if it was answered."""
        (answer,) = (frame.data for frame in self.sent(Frame(0x620, data)) if frame.can_id == 0x5A0)
        return f"{int.from_bytes(answer[4:], 'little'):08X}" if answer[0] == 0x80 else ""

    def write(self, index: int, sub: int, layout: str, value: float) -> str:
        data = struct.pack(f"<{layout}", value)
        return self.ask(struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, sub) + data.ljust(4, b"\0"))

    def begin(self, command: int, index: int, sub: int) -> str:
        """A segmented (20h) or block (C0h) download, of which nothing follows."""
        said = self.ask(struct.pack("<BHBI", command, index, sub, 64))
        if not said:
            self.sent(Frame(0x620, struct.pack("<BHBI", 0x80, index, sub, 0)))
        return said

    def unlock(self, code: int = CODE) -> str:
        return self.write(*od.WRITE_LOCK_UNLOCK_CODE, "I", code)


def refused(machine: Locked, code: str) -> None:
    """Each entry that SDO can write is locked, or is one of those that docs/service.md lists."""
    for entry in machine.module.dictionary:
        if entry.access in ("ro", "const"):
            continue
        place, before = (entry.index, entry.subindex), entry.value
        name = f"{entry.index:04X}:{entry.subindex:02X}"
        for command in (0x20, 0xC0):
            assert (machine.begin(command, *place) == code) is (name not in FREE), name
        if name not in FREE:
            assert machine.ask(struct.pack("<BHBI", 0x22, *place, 1)) == code, name
            assert entry.value == before
    assert machine.value(*od.WRITE_LOCK_LOCKED) == 1


def free(machine: Locked) -> None:
    assert machine.value(*od.WRITE_LOCK_LOCKED) == 0
    assert machine.write(0x1017, 0, "H", 500) == ""
    assert machine.write(0x2010, 3, "B", 5) == ""
    assert machine.begin(0x20, *od.TABLE_STAGED) == machine.begin(0xC0, *od.TABLE_STAGED) == ""
    assert machine.ask(struct.pack("<BHB4s", 0x23, 0x1010, 1, b"save")) == ""


def test_only_outside_of_operational() -> None:
    machine = Locked(write_lock="preop")
    free(machine)
    machine.nmt(1)
    refused(machine, STATE)
    assert machine.unlock() == LOCAL, "there is no code"
    machine.nmt(0x80)
    free(machine)
    assert machine.write(*od.WRITE_LOCK_MODE, "B", 0) == ""
    machine.nmt(1)
    free(machine)


def test_a_code_unlocks_until_a_reset() -> None:
    machine = Locked(write_lock="code", unlock_code=CODE)
    refused(machine, LOCAL)
    machine.nmt(1)
    refused(machine, LOCAL)
    assert machine.unlock() == ""
    free(machine)
    assert machine.unlock(0) == "", "locked by hand"
    refused(machine, LOCAL)
    assert machine.unlock() == ""
    machine.nmt(0x82)
    refused(machine, LOCAL)


def test_a_wrong_code_costs_a_second() -> None:
    machine = Locked(write_lock="code", unlock_code=CODE)
    for place in range(20):
        machine.bus.run_until(0.04 * place)
        assert machine.unlock(CODE ^ 1) == LOCAL
        assert machine.unlock() == LOCAL, "even the right one"
    machine.bus.run_until(1.0)
    assert machine.unlock() == ""
    assert machine.unlock(CODE ^ 1) == LOCAL
    free(machine)


def test_the_code_cannot_be_read_and_the_lock_is_in_no_backup() -> None:
    machine = Locked(write_lock="code", unlock_code=CODE)
    for sub in (2, 3):
        assert machine.ask(struct.pack("<BHB4x", 0x40, 0x2040, sub)) == "06010001"
    configuration = configuration_of(machine.module)
    assert not [place for place in configuration.values() if place[0] == 0x2040]
    assert not [place for place in backup_values(configuration) if place[0] == 0x2040]


def test_the_lock_is_saved() -> None:
    store = MemoryStore()
    machine = Locked(store)
    assert machine.write(*od.WRITE_LOCK_MODE, "B", 2) == "06090030", "without a code nobody could unlock it"
    assert machine.write(*od.WRITE_LOCK_NEW_UNLOCK_CODE, "I", CODE) == ""
    assert machine.write(*od.WRITE_LOCK_MODE, "B", 2) == ""
    assert machine.write(0x1017, 0, "H", 1) == LOCAL
    assert machine.unlock() == ""
    assert machine.write(*od.WRITE_LOCK_NEW_UNLOCK_CODE, "I", 0) == "06090030"
    assert machine.ask(struct.pack("<BHB4s", 0x23, 0x1010, 1, b"save")) == ""
    again = Locked(store)
    refused(again, LOCAL)
    assert again.unlock() == ""
    free(again)


def test_lss_is_locked_as_well() -> None:
    machine = Locked(write_lock="code", unlock_code=CODE)

    def lss(*data: int) -> list[bytes]:
        frames = machine.sent(Frame(0x7E5, bytes(data).ljust(8, b"\0")))
        return [frame.data[:2] for frame in frames if frame.can_id == 0x7E4]

    lss(0x04, 1)
    for command in (0x11, 0x13, 0x17):
        assert lss(command, 40) == [bytes((command, 1))]
    assert lss(0x15, 0) == []
    assert lss(0x5E) == [bytes((0x5E, 32))]
    assert machine.unlock() == ""
    assert lss(0x11, 40) == [b"\x11\x00"]


@pytest.mark.parametrize(("begin", "segment"), [(0x21, 0x0B), (0xC2, 0x81)], ids=["segmented", "block"])
def test_a_download_that_began_before_the_lock(begin: int, segment: int) -> None:
    machine = Locked(write_lock="preop")
    before = machine.value(0x1017)
    assert machine.ask(struct.pack("<BHBI", begin, 0x1017, 0, 2)) == ""
    machine.nmt(1)
    assert machine.ask(bytes((segment, 0x12, 0x34)).ljust(8, b"\0")) == STATE
    assert machine.value(0x1017) == before
