"""One task at a time, and only what is allowed."""

from __future__ import annotations

import pytest

from canfb.scope import desk as tasks
from canfb.scope.desk import Desk, ScopeRefusal, Stage, TaskResult, Upload, allowed_tasks

FILE = Upload("table.yaml", b"")


def desk_of(*, asks: bool, writes: bool) -> tuple[Desk, list[object]]:
    begun: list[object] = []
    return Desk(lambda *what: begun.append(what), allowed_tasks(asks=asks, writes=writes)), begun


@pytest.mark.parametrize("task", tasks.TASKS)
def test_what_only_listens_does_nothing(task: tasks.ScopeTask) -> None:
    desk, begun = desk_of(asks=False, writes=False)
    with pytest.raises(ScopeRefusal, match="--write"):
        desk.begin(task, 32, FILE)
    assert begun == []
    assert desk.state.stage is Stage.IDLE


def test_what_reads_writes_nothing() -> None:
    desk, _ = desk_of(asks=True, writes=False)
    assert desk.allowed == (tasks.READ, tasks.MEASURE)
    for task in (tasks.CALIBRATE, tasks.UPLOAD, tasks.ACTIVATE, tasks.SAVE):
        with pytest.raises(ScopeRefusal, match="read-only"):
            desk.begin(task, 32, FILE)


def test_one_at_a_time() -> None:
    desk, begun = desk_of(asks=True, writes=True)
    code = str(desk.code)
    desk.begin(tasks.SAVE, 32, code=code)
    with pytest.raises(ScopeRefusal, match="wait for the end of Save, module 32"):
        desk.begin(tasks.ACTIVATE, 32, code=code)
    desk.step("saving")
    desk.part(1.7)
    assert (desk.state.step, desk.state.part) == ("saving", 1.0)
    desk.end(TaskResult(False, ["it is full"]))
    assert desk.state.stage is Stage.FAILED
    assert desk.state.lines == ("it is full",)
    desk.begin(tasks.ACTIVATE, 32, code=code)
    assert len(begun) == 2


def test_an_upload_needs_its_file() -> None:
    desk, begun = desk_of(asks=True, writes=True)
    with pytest.raises(ScopeRefusal, match="choose a file"):
        desk.begin(tasks.UPLOAD, 32, code=desk.code.code)
    assert begun == []


@pytest.mark.parametrize("task", tasks.TASKS)
def test_what_writes_begins_with_its_code_alone(task: tasks.ScopeTask) -> None:
    desk, begun = desk_of(asks=True, writes=True)
    for wrong in ("", "ABCD-EFGH", desk.code.code[:-1]):
        if task.writes:
            with pytest.raises(ScopeRefusal, match="code"):
                desk.begin(task, 32, FILE, wrong)
    assert begun == []
    desk.begin(task, 32, FILE, desk.code.code if task.writes else "")
    assert begun == [(task, 32, FILE)]
