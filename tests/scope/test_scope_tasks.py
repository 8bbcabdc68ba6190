"""The tasks of canfb scope on a simulated network: what they say, and what the module has then."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from canfb.cia301.frame import Frame
from canfb.scope.desk import ModuleTasks, TaskResult, result_of
from canfb.signal.correction import CorrectionTable
from commissioning_kit import INTERFACE_ID, MODULE_ID, Bench


class Heard:
    def __init__(self) -> None:
        self.steps: list[str] = []
        self.parts: list[float] = []

    def step(self, text: str) -> None:
        self.steps.append(text)

    def part(self, part: float) -> None:
        self.parts.append(part)

    def clear(self) -> None:
        pass


def tasks_of(bench: Bench) -> ModuleTasks:
    return ModuleTasks(bench.master, MODULE_ID, INTERFACE_ID, "2026-11-22 12:00:00", 3000, 3.0)


def table() -> CorrectionTable:
    raw = np.arange(64) / 64
    return CorrectionTable(raw + 0.01 * np.sin(2 * np.pi * raw))


def test_a_table_is_staged_and_then_activated() -> None:
    bench = Bench()
    tasks = tasks_of(bench)
    done = result_of(lambda: tasks.upload("new.bin", table().to_bytes()), tasks.module)
    assert done.worked
    assert bench.value(0x2020, 2) == table().crc32
    assert bench.value(0x2020, 4) == 0
    assert "staged in module 32 (20h), not in force yet: Activate puts it in force" in done.lines
    done = result_of(tasks.activate, tasks.module)
    assert done.worked
    assert any(line.endswith("not saved: Save keeps it") for line in done.lines)
    assert bench.value(0x2020, 4) == table().crc32
    assert done.active is not None
    assert done.active.table == table()


def test_what_is_no_table_changes_nothing_and_says_so() -> None:
    bench = Bench()
    tasks = tasks_of(bench)
    for name, data in (("new.yaml", b"entries: 7"), ("new.bin", b"\xff" * 64), ("../../etc/x.bin", b"")):
        done = result_of(partial(tasks.upload, name, data), tasks.module)
        assert not done.worked
        assert "not a correction table" in done.lines[0]
        assert "/" not in done.lines[0].partition(":")[0]
        assert any(line.startswith("active table") for line in done.lines)
        assert bench.value(0x2020, 2) == 0


def test_without_a_staged_table_nothing_is_activated() -> None:
    tasks = tasks_of(Bench())
    done = result_of(tasks.activate, tasks.module)
    assert not done.worked
    assert done.lines[0] == "module 32 (20h): nothing is staged; upload one first"


def test_a_module_that_cannot_save_says_so() -> None:
    tasks = tasks_of(Bench())
    done = result_of(tasks.save, tasks.module)
    assert not done.worked
    assert "state_dir" in done.lines[0]


def test_the_calibration_reports_before_and_after() -> None:
    bench, heard = Bench(), Heard()
    tasks = tasks_of(bench)
    done = result_of(lambda: tasks.calibrate(heard, dry_run=True), tasks.module)
    assert done.worked, done.lines
    assert bench.value(0x2020, 4) == 0
    assert done.measured is not None
    assert done.measured.before.std() > 3.0 * done.measured.after.std()
    done = result_of(lambda: tasks.calibrate(heard, dry_run=False), tasks.module)
    assert done.worked, done.lines
    assert any("before" in line and "after" in line for line in done.lines)
    assert bench.value(0x2020, 4) != 0
    assert "verifying on fresh samples" in heard.steps
    assert max(heard.parts) == 1.0


def test_a_module_that_does_not_answer_has_no_known_state() -> None:
    bench = Bench()
    tasks = tasks_of(bench)
    silent: Any = lambda frame, now: []  # noqa: E731
    receive = bench.module.receive

    def deaf(frame: Frame, now: float) -> list[Frame]:
        return silent(frame, now) if frame.can_id == 0x600 + MODULE_ID else receive(frame, now)

    bench.module.receive = deaf  # type: ignore[method-assign]
    done = result_of(tasks.activate, tasks.module)
    assert not done.worked
    assert done.active is None
    assert "the state of the module could not be read" in done.lines[-1]
    assert not any("nothing was" in line for line in done.lines)
    done = result_of(lambda: TaskResult(True, []), tasks.module)  # reading alone
    assert not done.worked
