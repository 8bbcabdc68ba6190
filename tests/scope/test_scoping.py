"""The thread of a task of canfb scope: what it may send, and what it says when it fails."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any
from uuid import uuid4

import can
import pytest

from canfb.bus.bus_master import BusMaster
from canfb.bus.shared_bus import SharedBus
from canfb.cia301.frame import Frame
from canfb.errors import CanfbError
from canfb.master.access import CommissioningError, NodeAccess
from canfb.scope import desk as tasks
from canfb.scope.desk import Desk, ScopeTask, Stage, TaskResult, Upload
from canfb.scope.scoping import PausedReading, SendRule, TaskSteps, TaskThread, refusal_of
from canfb.scope.traces import BusTraces
from canfb.signal.correction import NO_CORRECTION

Act = Callable[[BusMaster, TaskSteps], TaskResult]


class AtOnce:
    """In place of the loop of the server."""

    def soon(self, call: Callable[..., object], *arguments: Any) -> None:
        call(*arguments)


@pytest.fixture
def other() -> Iterator[can.BusABC]:
    with can.Bus(interface="virtual", channel=f"scoping {uuid4()}", receive_own_messages=False) as bus:
        yield bus


def ended(other: can.BusABC, task: ScopeTask, act: Act, traces: BusTraces | None = None) -> Desk:
    """The desk when the task has ended."""

    def run(
        task: ScopeTask, node: int, upload: Upload | None, master: BusMaster, steps: TaskSteps
    ) -> TaskResult:
        return act(master, steps)

    channel: Any = other
    with SharedBus(can.Bus(interface="virtual", channel=channel.channel_id)) as bus:
        worker = TaskThread(bus, run, traces or BusTraces(), [])
        desk = Desk(worker.begin, tasks.TASKS)
        loop: Any = AtOnce()
        worker.loop, worker.desk = loop, desk
        desk.begin(task, 0x20, code=desk.code.code)
        worker.end()
    return desk


@pytest.mark.parametrize("task", [tasks.READ, tasks.MEASURE])
def test_what_does_not_write_cannot(other: can.BusABC, task: ScopeTask) -> None:
    """Also with --write, and whatever the task tries."""

    def act(master: BusMaster, steps: TaskSteps) -> TaskResult:
        for node in (NodeAccess(master, 0x20, "module"), NodeAccess(master, 0x10, "encoder interface")):
            with pytest.raises(CommissioningError, match="this only reads"):
                node.write(0x1017, 0, "H", 100)
            with pytest.raises(CommissioningError, match="this only reads"):
                node.download_domain(0x2020, 1, bytes(64))
        with pytest.raises(CanfbError, match="this only reads"):
            master.send(0x000, b"\x82\x00")
        return TaskResult(True, [])

    assert ended(other, task, act).state.stage is Stage.DONE
    while (sent := other.recv(0.0)) is not None:
        assert (sent.arbitration_id & 0x780, sent.data[0]) == (0x600, 0x80)  # aborts of what never began


def test_what_writes_does(other: can.BusABC) -> None:
    def act(master: BusMaster, steps: TaskSteps) -> TaskResult:
        master.send(0x620, bytes.fromhex("2310100173617665"))
        return TaskResult(True, [], NO_CORRECTION)

    traces = BusTraces()
    assert ended(other, tasks.SAVE, act, traces).state.stage is Stage.DONE
    heard = other.recv(30.0)
    assert heard is not None
    assert heard.arbitration_id == 0x620
    assert traces.of(0x20).correction == NO_CORRECTION


def test_a_program_error_claims_nothing_of_the_module(
    other: can.BusABC, caplog: pytest.LogCaptureFixture
) -> None:
    def act(master: BusMaster, steps: TaskSteps) -> TaskResult:
        raise ZeroDivisionError("oh")

    state = ended(other, tasks.ACTIVATE, act).state
    assert state.stage is Stage.FAILED
    assert "ZeroDivisionError" in state.lines[0]
    assert state.lines[1] == "the state of the module was not read back: read the table to see it"
    assert "program error" in caplog.text


def test_the_end_interrupts_a_task_that_runs(other: can.BusABC) -> None:
    def act(master: BusMaster, steps: TaskSteps) -> TaskResult:
        try:
            while True:
                steps.part(0.5)
        except CanfbError as error:
            return TaskResult(False, [str(error)])

    assert ended(other, tasks.MEASURE, act).state.lines == ("canfb scope ends",)


@pytest.mark.parametrize("rule", [SendRule.NOTHING, SendRule.READS])
@pytest.mark.parametrize(
    "kind", [{"is_extended_id": True}, {"is_remote_frame": True}, {"is_fd": True}, {"data": b"\x23"}]
)
def test_other_kinds_of_frames_are_refused(rule: SendRule, kind: dict[str, Any]) -> None:
    fields: dict[str, Any] = {
        "arbitration_id": 0x620,
        "is_extended_id": False,
        "data": bytes([0x40, *bytes(7)]),
    } | kind
    assert refusal_of(rule)(can.Message(**fields)) == rule.value
    assert refusal_of(SendRule.ALL)(can.Message(**fields)) == ""


def test_a_paused_reading_asks_nothing_and_takes_no_answer_of_others() -> None:
    reading = PausedReading(0x20)
    asked = reading.next(0.0)
    assert asked is not None
    reading.paused = True
    answer = Frame(0x5A0, bytes([0x4B, *asked.data[1:4], 1, 0, 0, 0]))
    assert not reading.receive(answer)
    assert reading.next(10.0) is None
    reading.paused = False
    assert reading.next(20.0) is not None
