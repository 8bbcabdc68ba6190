"""A store that writes in the background: the node goes on, and answers when the values are kept."""

from collections import deque
from collections.abc import Callable
from typing import Any

import pytest
from device_kit import ID, OK, RESET_NODE, VERIFY, Bench

from canfb import FeedbackModule, ModuleConfig
from canfb.device.storage.kept import ParameterGroup
from canfb.device.storage.storage import MOST_WAITING, POLL_S, Changes, MemoryStore
from folding import each

SAVE, LOAD = "2310100173617665", "231110016C6F6164"
SAVED, LOADED = "6010100100000000", "6011100100000000"
HARDWARE = "8010100100000606"
REQUEST_2, ANSWER_2 = 0x6C0, 0x540
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


class Machine(Bench):
    """A module with such a store, powered on."""

    def __init__(self) -> None:
        self.store, self.now = SlowStore(), 0.0
        self.node: Any = FeedbackModule(ModuleConfig(node_id=ID), self.store)
        self.dictionary = self.node.dictionary
        self.start()
        self.events: list[str] = []
        self.node.events.on_event = lambda event: self.events.append(event.text)

    def later(self, seconds: float = 0.05) -> list[str]:
        """All but heartbeats that the module sends by itself meanwhile."""
        return [text for _, text in self.run(seconds) if not text.startswith("720#")]

    def value(self, index: int, subindex: int = 0) -> int:
        return int(self.dictionary.entry(index, subindex).current())


def expedited(machine: Machine) -> tuple[list[str], str]:
    return machine.sdo(SAVE), SAVED


def segmented(machine: Machine) -> tuple[list[str], str]:
    assert machine.sdo("2110100104000000") == [SAVED]
    return machine.sdo("0773617665"), "2000000000000000"


def block(machine: Machine) -> tuple[list[str], str]:
    assert machine.sdo("C210100104000000")
    assert machine.sdo("8173617665")
    return machine.sdo("CD"), "A100000000000000"


SAVED_LINE = "parameters saved: communication, application, manufacturer"
FAILED_LINE = "parameters not saved (No space left on device): communication, application, manufacturer"


@pytest.mark.parametrize("kind", [expedited, segmented, block])
@pytest.mark.parametrize(("error", "line"), [(None, SAVED_LINE), (FULL, FAILED_LINE)])
def test_the_answer_comes_when_the_values_are_kept_or_not(
    kind: Callable[[Machine], tuple[list[str], str]], error: OSError | None, line: str
) -> None:
    machine = Machine()
    assert machine.write(0x1017, 0, 0, 2) == OK
    answers, confirmed = kind(machine)
    assert answers == []
    assert machine.later(1.5) == [], "no time-out, no answer before it is on the disk"
    assert machine.store.images == {}
    machine.store.finish(error)
    assert machine.later(2 * POLL_S) == [f"5A0#{HARDWARE if error else confirmed}"]
    assert bool(machine.store.images) is (error is None)
    assert [text for text in machine.events if "saved" in text] == [line]
    assert machine.node.deadline() is None, "nothing is asked for any more"
    machine.sdo(SAVE)
    machine.store.finish()
    assert machine.later() == [f"5A0#{SAVED}"]


@each("can_id, data", [
    (0x620, "4000100000000000"),
    (0x620, "8010100100000405"),
    *((0x000, f"{command}20") for command in ("02", "81", "82")),
])  # fmt: skip
def test_what_ends_the_transfer_ends_no_save_and_gets_no_late_answer(can_id: int, data: str) -> None:
    machine = Machine()
    assert machine.write(0x1017, 0, 500, 2) == OK
    assert machine.sdo(SAVE) == []
    answers = [text for text in machine.send(can_id, data) if text.startswith("5A0#")]
    assert len(answers) == data.startswith("40")
    machine.store.finish()
    assert machine.later() == []
    assert ParameterGroup.COMMUNICATION in machine.store.images
    machine.nmt(RESET_NODE)
    assert machine.value(0x1017) == 500


def test_two_clients_each_get_their_answer() -> None:
    machine = Machine()
    for sub, can_id in ((1, REQUEST_2), (2, ANSWER_2)):
        assert machine.write(0x1201, sub, can_id, 4) == OK
    assert machine.sdo(SAVE) == machine.sdo(LOAD, REQUEST_2) == []
    machine.store.finish(FULL)
    assert machine.later() == [f"5A0#{HARDWARE}"]
    machine.store.finish()
    assert machine.later() == [f"{ANSWER_2:03X}#{LOADED}"]


def test_load_clears_1020h_when_it_is_done() -> None:
    machine = Machine()
    machine.sdo(SAVE)
    machine.store.finish()
    machine.later()
    assert machine.write(VERIFY, 1, 7, 4) == OK
    for error, left in ((FULL, 7), (None, 0)):
        assert machine.sdo(LOAD) == []
        assert machine.value(VERIFY, 1) == 7
        machine.store.finish(error)
        machine.later()
        assert machine.value(VERIFY, 1) == left


def test_a_client_that_repeats_itself_fills_no_memory() -> None:
    machine = Machine()
    for _ in range(MOST_WAITING):
        assert machine.sdo(SAVE) == []
    for _ in range(10):
        assert machine.sdo(SAVE) == ["8010100122000008"]
    assert len(machine.store.begun) == MOST_WAITING
    for _ in range(MOST_WAITING):
        machine.store.finish()
    assert machine.later() == [], "who repeated it waits for the last answer alone"
    assert machine.sdo(SAVE) == []


def test_lss_answers_when_the_node_id_is_kept() -> None:
    machine = Machine()
    for error, code in ((None, "00"), (FULL, "02")):
        machine.sdo("0401", 0x7E5)
        assert machine.sdo("17", 0x7E5) == []
        machine.store.finish(error)
        assert machine.later() == [f"7E4#17{code}000000000000"]
