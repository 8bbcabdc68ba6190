"""restore, table upload, commission and calibrate with a node that fails at any request of theirs.

The module is as before or as wanted, and the tool says which. A node that is gone is as before or as wanted
when its power comes back. All requests: CANFB_EVERY_REQUEST=1.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from canfb import CanfbError, Conditioning, FeedbackModule, Frame, ModuleConfig, eds_path
from canfb.calibrate.measurement import Measurement, Settings
from canfb.calibrate.procedure import install, verify
from canfb.calibration.deviation import Deviation
from canfb.cli.backup_command import backup_of
from canfb.commission.commission_run import set_limits
from canfb.device.storage.kept import ParameterGroup
from canfb.device.storage.storage import Changes, MemoryStore
from canfb.master.all_or_nothing import Guard, save
from canfb.master.samples import TrackSamples
from canfb.module.device_configuration import configuration_of, read_configuration, restored_configuration
from canfb.objects import SUPERVISION_PHASE_ERROR, Multiplexer
from canfb.sdo.backups import Backup, restore_backup
from canfb.sdo.object_description import ObjectDescriptions
from canfb.sdo.tables import TableFile, TableTasks
from canfb.signal.correction import Correction, CorrectionTable
from commissioning_kit import MODULE_ID, Bench, bench_with
from ideal_tracks import wavy_table
from node_commands import ANSWER, REQUEST, abort

RESET = Frame(0x000, bytes((0x81, MODULE_ID)))
DEAF_S = 0.5
EVERY = "CANFB_EVERY_REQUEST" in os.environ
"""At every single request, which takes minutes; else at some of them."""

Values = dict[tuple[int, int], Any]


class Adversary:
    """Between the bus and the module of a bench: ``fault`` happens at SDO request ``at``, from 1.

    refused, request lost, answer lost   this one request
    deaf                                 half a second without an SDO response
    reset, reset after                   before this request, or instead of the response
    killed, killed after                 the same, and it does not come back
    interrupted                          Ctrl-C
    """

    FAULTS = (
        "refused", "request lost", "answer lost", "deaf", "reset",
        "reset after", "killed", "killed after", "interrupted",
    )  # fmt: skip

    def __init__(self, bench: Bench, fault: str = "", at: int = 0) -> None:
        self.requests = 0
        self.dead = False
        self._fault, self._at, self._deaf_until = fault, at, 0.0
        self._receive = bench.module.receive
        bench.module.receive = self.receive  # type: ignore[method-assign]

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        if self.dead:
            return []
        if frame.can_id != REQUEST:
            return self._receive(frame, now)
        self.requests += 1
        if now < self._deaf_until:
            return []
        return self._spoiled(frame, now) if self.requests == self._at else self._receive(frame, now)

    def _spoiled(self, frame: Frame, now: float) -> list[Frame]:
        fault = self._fault
        if fault == "interrupted":
            raise KeyboardInterrupt
        if fault == "refused":
            return abort(frame)
        if fault == "reset":
            return self._receive(RESET, now) + self._receive(frame, now)
        if fault == "deaf":
            self._deaf_until = now + DEAF_S
        self.dead = fault.startswith("killed")
        if fault.endswith(("after", "answer lost")):
            frames = [one for one in self._receive(frame, now) if one.can_id != ANSWER]
            return frames + self._receive(RESET, now) if fault == "reset after" else frames
        return []


@dataclass(frozen=True)
class Held:
    """What a module holds, and what it would hold after the power was off."""

    values: Values
    used: Correction
    saved_values: Values
    saved: Correction

    @classmethod
    def of(cls, bench: Bench) -> Held:
        return cls(*_held(bench.module), *kept(bench))

    @property
    def kept(self) -> tuple[Values, Correction]:
        """What the power does not take."""
        return self.saved_values, self.saved


def _held(module: FeedbackModule) -> tuple[Values, Correction]:
    return configuration_of(module).values(), module.chain.correction


def kept(bench: Bench) -> tuple[Values, Correction]:
    assert isinstance(bench.store, MemoryStore)
    return _switched_on(bench.module.config, frozenset(bench.store.images.items()))


@cache
def _switched_on(
    config: ModuleConfig, images: frozenset[tuple[ParameterGroup, bytes]]
) -> tuple[Values, Correction]:
    """What a module holds that starts with these; most faults leave the same ones."""
    store = MemoryStore()
    store.images = dict(images)
    module = FeedbackModule(config, store)
    module.start(0.0)
    return _held(module)


@dataclass(frozen=True)
class Task:
    """A command with a module that it changes: ``prepare`` makes it, with all that it holds saved."""

    prepare: Callable[[], Bench]
    run: Callable[[Bench], object]

    def undisturbed(self) -> tuple[Held, int]:
        """What comes of it, and after how many SDO requests."""
        bench = self.prepare()
        adversary = Adversary(bench)
        self.run(bench)
        return Held.of(bench), adversary.requests

    def check(self, fault: str, at: int, wanted: Held) -> str:
        """The module is as before or as wanted, and the task says which: "" or why it has failed."""
        bench = self.prepare()
        assert isinstance(bench.store, MemoryStore)
        before = Held.of(bench)
        assert before.kept == (before.values, before.used)
        adversary, saves, save = Adversary(bench, fault, at), [before.kept], bench.store.save

        def save_and_look(changes: Changes) -> None:
            save(changes)
            saves.append(kept(bench))

        bench.store.save = save_and_look  # type: ignore[method-assign]
        said = ""
        try:
            self.run(bench)
        except (CanfbError, KeyboardInterrupt) as error:
            said = str(error) or "interrupted"
        assert adversary.requests >= at, "the fault came"
        assert "\n" not in said
        assert all(one in (before.kept, wanted.kept) for one in saves), "nothing in between was saved"
        held = Held.of(bench)
        done = not said or said.startswith("done: ")
        if adversary.dead:
            assert "switch module 32 (20h) off and on" in said or "no answer" in said, said
            saved = [before.kept, wanted.kept] if "or the new values" in said else [before.kept]
            assert held.kept in ([wanted.kept] if done else saved), said
        else:
            assert "could not be restored" not in said
            assert held == (wanted if done else before), said
        return said


def requests(fault: str, last: int, step: int) -> range:
    """The requests of a task at which a fault is tried: each fault begins at another one."""
    return range(1, last + 1) if EVERY else range(1 + Adversary.FAULTS.index(fault), last + 1, step)


NEW = Correction(wavy_table(16), Conditioning(sine_offset_counts=3.5))
OLD = Correction(CorrectionTable.identity(16), Conditioning(sine_gain=1.25))
CONFIG = {"coast_samples": 5}
LIMITS = {Multiplexer(0x2010, 1): 9000, Multiplexer(0x2010, 2): 12.5, Multiplexer(0x2010, 4): 3}
LIMITS_BEFORE = {Multiplexer(0x2010, 1): 21845, Multiplexer(0x2010, 2): 0.0, Multiplexer(0x2010, 4): 0}


@cache
def saved(used: Correction, phase_error: int) -> dict[ParameterGroup, bytes]:
    store = MemoryStore()
    bench = bench_with(used, store=store, config=CONFIG)
    bench.access.write(*SUPERVISION_PHASE_ERROR, "H", phase_error)
    save(bench.access)
    return store.images


def prepared(used: Correction = OLD, *, operational: bool = True, phase_error: int = 819) -> Bench:
    store = MemoryStore()
    store.images = dict(saved(used, phase_error))
    return Bench(sync=False, operational=operational, store=store, config=CONFIG)


@cache
def backup() -> Backup:
    bench = prepared(NEW, operational=False)
    bench.access.write(0x1017, 0, "H", 500)
    bench.access.write(0x2010, 2, "f", 12.5)
    return backup_of(bench.access, ObjectDescriptions(eds_path("canfb-module"), MODULE_ID), "2026-03-01")


def restore(bench: Bench) -> object:
    kept = backup()
    return restore_backup(
        bench.access,
        kept,
        lambda: read_configuration(bench.access),
        lambda before: restored_configuration(kept.values, before, kept.table, MODULE_ID, MODULE_ID),
        Guard(),
        keep=True,
    )


def upload(bench: Bench) -> object:
    file = TableFile(Path("table.yaml"), NEW, True)
    return TableTasks(bench.access, Guard()).upload(file, active=True, keep=True)


def clear(bench: Bench) -> object:
    return TableTasks(bench.access, Guard()).clear(conditioning=True, keep=True)


def limits(bench: Bench) -> object:
    return set_limits(bench.access, LIMITS_BEFORE, LIMITS, lambda: None, Guard(), keep=True)


TASKS = {
    "restore": (Task(lambda: prepared(operational=False), restore), 61),
    "table upload": (Task(prepared, upload), 9),
    "table clear": (Task(lambda: prepared(NEW, phase_error=300), clear), 9),
    "commission": (Task(prepared, limits), 1),
}


@cache
def undisturbed(name: str) -> tuple[Held, int]:
    return TASKS[name][0].undisturbed()


@pytest.mark.parametrize("fault", Adversary.FAULTS)
@pytest.mark.parametrize("name", TASKS)
def test_as_before_or_as_wanted(name: str, fault: str) -> None:
    task, step = TASKS[name]
    wanted, last = undisturbed(name)
    for at in requests(fault, last, step):
        task.check(fault, at, wanted)


@pytest.mark.parametrize("fault", Adversary.FAULTS)
def test_a_calibration(
    fault: str, measured: Measurement, old: Correction, fresh: TrackSamples, settings: Settings
) -> None:
    def prove(found: Measurement) -> Deviation:
        return verify(fresh, found, settings)

    task = Task(lambda: prepared(old), lambda bench: install(bench.access, measured, prove, Guard()))
    wanted, last = task.undisturbed()
    for at in {*requests(fault, last, 11), last}:  # the last one saves
        task.check(fault, at, wanted)
