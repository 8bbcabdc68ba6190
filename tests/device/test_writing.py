"""A store that writes in the background: the node goes on, and answers when the values are kept."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable

import pytest

from canfb.cia301.frame import Frame
from canfb.device.storage.kept import ParameterGroup
from canfb.device.storage.storage import MOST_WAITING, POLL_S, Changes, MemoryStore
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig

REQUEST, ANSWER, REQUEST_2, ANSWER_2 = 0x620, 0x5A0, 0x6C0, 0x540
SAVE, LOAD = struct.pack("<BHB4s", 0x23, 0x1010, 1, b"save"), struct.pack("<BHB4s", 0x23, 0x1011, 1, b"load")
SAVED, LOADED = bytes.fromhex("6010100100000000"), bytes.fromhex("6011100100000000")
HARDWARE = bytes.fromhex("8010100100000606")
FULL = OSError(28, "No space left on device")


class SlowStore(MemoryStore):
    """Keeps what was begun when the test says so."""

    def __init__(self) -> None:
        super().__init__()
        self.begun: deque[Changes] = deque()
        self._ended: list[OSError | None] = []

    def begin(self, changes: Changes) -> None:
        self.begun.append(changes)

    def finish(self, error: OSError | None = None) -> None:
        changes = self.begun.popleft()
        if error is None:
            self.save(changes)
        self._ended.append(error)

    def ended(self) -> list[OSError | None]:
        ended, self._ended = self._ended, []
        return ended


class Machine:
    def __init__(self) -> None:
        self.store = SlowStore()
        self.now = 0.0
        self.module = FeedbackModule(ModuleConfig(node_id=32), self.store)
        self.module.start(0.0)
        self.events: list[str] = []
        self.module.events.on_event = lambda event: self.events.append(event.text)

    def send(self, data: bytes, can_id: int = REQUEST) -> list[bytes]:
        return self.answers(self.module.receive(Frame(can_id, data), self.now))

    def answers(self, frames: list[Frame], can_id: int = ANSWER) -> list[bytes]:
        return [frame.data for frame in frames if frame.can_id == can_id]

    def later(self, seconds: float = 0.05) -> list[Frame]:
        """Everything that the module sends by itself meanwhile."""
        end, frames = self.now + seconds, []
        while (due := self.module.deadline()) is not None and due <= end:
            self.now = max(self.now, due)
            frames += self.module.tick(self.now)
        self.now = end
        return frames

    def value(self, index: int, subindex: int = 0) -> int:
        return int(self.module.dictionary.entry(index, subindex).current())


def expedited(machine: Machine) -> tuple[list[bytes], bytes]:
    return machine.send(SAVE), SAVED


def segmented(machine: Machine) -> tuple[list[bytes], bytes]:
    assert machine.send(bytes.fromhex("2110100104000000")) == [SAVED]
    return machine.send(b"\x07save\0\0\0"), bytes.fromhex("2000000000000000")


def block(machine: Machine) -> tuple[list[bytes], bytes]:
    assert machine.send(bytes.fromhex("C210100104000000"))
    assert machine.send(b"\x81save\0\0\0")
    return machine.send(bytes.fromhex("CD00000000000000")), bytes.fromhex("A100000000000000")


KINDS = (expedited, segmented, block)
Kind = Callable[[Machine], tuple[list[bytes], bytes]]


SAVED_LINE = "parameters saved: communication, application, manufacturer"
FAILED_LINE = "parameters not saved (No space left on device): communication, application, manufacturer"


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("error", "line"), [(None, SAVED_LINE), (FULL, FAILED_LINE)])
def test_the_answer_comes_when_the_values_are_kept_or_not(
    kind: Kind, error: OSError | None, line: str
) -> None:
    machine = Machine()
    machine.send(struct.pack("<BHBH2x", 0x2B, 0x1017, 0, 0))
    answers, confirmed = kind(machine)
    assert answers == []
    assert machine.answers(machine.later(1.5)) == [], "no time-out, no answer before it is on the disk"
    assert machine.store.images == {}
    machine.store.finish(error)
    assert machine.answers(machine.later(2 * POLL_S)) == [HARDWARE if error else confirmed]
    assert bool(machine.store.images) is (error is None)
    assert [text for text in machine.events if "saved" in text] == [line]
    assert machine.module.deadline() is None, "nothing is asked for any more"
    machine.send(SAVE)
    machine.store.finish()
    assert machine.answers(machine.later()) == [SAVED]


@pytest.mark.parametrize(
    ("can_id", "data"),
    [
        (REQUEST, b"\x40\x00\x10\0\0\0\0\0"),
        (REQUEST, b"\x80\x10\x10\x01\0\0\x04\x05"),
        *((0x000, bytes((command, 32))) for command in (0x02, 0x81, 0x82)),
    ],
)
def test_what_ends_the_transfer_ends_no_save_and_gets_no_late_answer(can_id: int, data: bytes) -> None:
    machine = Machine()
    machine.send(struct.pack("<BHBH2x", 0x2B, 0x1017, 0, 500))
    assert machine.send(SAVE) == []
    assert len(machine.send(data, can_id)) == (data[0] == 0x40)
    machine.store.finish()
    assert machine.answers(machine.later()) == []
    assert ParameterGroup.COMMUNICATION in machine.store.images
    machine.module.receive(Frame(0x000, b"\x81\x20"), machine.now)
    assert machine.value(0x1017) == 500


def test_two_clients_each_get_their_answer() -> None:
    machine = Machine()
    for sub, can_id in ((1, REQUEST_2), (2, ANSWER_2)):
        machine.send(struct.pack("<BHBI", 0x23, 0x1201, sub, can_id))
    assert machine.send(SAVE) == []
    assert machine.module.receive(Frame(REQUEST_2, LOAD), machine.now) == []
    machine.store.finish(FULL)
    frames = machine.later()
    assert machine.answers(frames) == [HARDWARE]
    assert machine.answers(frames, ANSWER_2) == []
    machine.store.finish()
    assert machine.answers(machine.later(), ANSWER_2) == [LOADED]


def test_load_clears_1020h_when_it_is_done() -> None:
    machine = Machine()
    machine.send(SAVE)
    machine.store.finish()
    machine.later()
    machine.send(struct.pack("<BHBI", 0x23, 0x1020, 1, 7))
    for error, left in ((FULL, 7), (None, 0)):
        assert machine.send(LOAD) == []
        assert machine.value(0x1020, 1) == 7
        machine.store.finish(error)
        machine.later()
        assert machine.value(0x1020, 1) == left


def test_a_client_that_repeats_itself_fills_no_memory() -> None:
    machine = Machine()
    for _ in range(MOST_WAITING):
        assert machine.send(SAVE) == []
    for _ in range(10):
        assert machine.send(SAVE) == [bytes.fromhex("8010100122000008")]
    assert len(machine.store.begun) == MOST_WAITING
    for _ in range(MOST_WAITING):
        machine.store.finish()
    assert machine.answers(machine.later()) == [], "who repeated it waits for the last answer alone"
    assert machine.send(SAVE) == []


def test_lss_answers_when_the_node_id_is_kept() -> None:
    machine = Machine()
    for error, code in ((None, 0), (FULL, 2)):
        machine.send(b"\x04\x01".ljust(8, b"\0"), 0x7E5)
        assert machine.module.receive(Frame(0x7E5, b"\x17".ljust(8, b"\0")), machine.now) == []
        machine.store.finish(error)
        assert machine.answers(machine.later(), 0x7E4) == [bytes((0x17, code)).ljust(8, b"\0")]
