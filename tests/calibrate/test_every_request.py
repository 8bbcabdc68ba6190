"""restore, table upload, commission and calibrate with a node that fails at any request of theirs.

The module is as before or as wanted, and the tool says which. A node that is gone is as before or as wanted
when its power comes back. All requests: CANFB_EVERY_REQUEST=1.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from adversary import Adversary, Held, Task, requests

from canfb.calibrate.measurement import Measurement, Settings
from canfb.calibrate.procedure import install, verify
from canfb.calibration.deviation import Deviation
from canfb.cli.backup_command import backup_of
from canfb.commission.commission_run import set_limits
from canfb.device.storage.storage import MemoryStore
from canfb.master.all_or_nothing import Guard, put_in_force, save
from canfb.master.samples import TrackSamples
from canfb.objects import Multiplexer
from canfb.sdo.backup_file import Backup
from canfb.sdo.table_file import TableFile
from canfb.sdo.table_tasks import TableTasks
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import Correction, CorrectionTable
from commissioning_kit import MODULE_ID, Bench
from restoring_kit import restore_from

PHASES = np.arange(16) / 16
NEW = Correction(
    CorrectionTable(PHASES + 0.01 * np.sin(2 * np.pi * PHASES)), Conditioning(sine_offset_counts=3.5)
)
OLD = Correction(CorrectionTable.identity(16), Conditioning(sine_gain=1.25))
LIMITS = {Multiplexer(0x2010, 1): 9000, Multiplexer(0x2010, 2): 12.5, Multiplexer(0x2010, 4): 3}
LIMITS_BEFORE = {Multiplexer(0x2010, 1): 21845, Multiplexer(0x2010, 2): 0.0, Multiplexer(0x2010, 4): 0}


def prepared(used: Correction = OLD, *, operational: bool = True) -> Bench:
    bench = Bench(sync=False, operational=operational, store=MemoryStore(), config={"coast_samples": 5})
    put_in_force(bench.access, used)
    save(bench.access)
    return bench


@cache
def backup() -> Backup:
    bench = prepared(NEW, operational=False)
    bench.access.write(0x1017, 0, "H", 500)
    bench.access.write(0x2010, 2, "f", 12.5)
    return backup_of(bench.master, MODULE_ID, "2026-03-01")


def restore(bench: Bench) -> object:
    return restore_from(backup(), bench)


def upload(bench: Bench) -> object:
    file = TableFile(Path("table.yaml"), NEW, True)
    return TableTasks(bench.access, Guard()).upload(file, active=True, keep=True)


def limits(bench: Bench) -> object:
    return set_limits(bench.access, LIMITS_BEFORE, LIMITS, lambda: None, Guard(), keep=True)


TASKS = {
    "restore": (Task(lambda: prepared(operational=False), restore), 61),
    "table upload": (Task(prepared, upload), 9),
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
