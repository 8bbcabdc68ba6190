"""A restore in which one SDO request fails, whichever: the backup is in force, or all is as it was before."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from canfb.cia301.frame import Frame
from canfb.cli.backup_command import backup_of
from canfb.device.storage.storage import MemoryStore
from canfb.errors import CanfbError
from canfb.master.all_or_nothing import put_in_force
from canfb.module.device_configuration import configuration_of
from canfb.sdo.backup_file import Backup
from canfb.sdo.backup_tasks import Restored
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import Correction, CorrectionTable
from commissioning_kit import MODULE_ID, Bench
from node_commands import ANSWER, REQUEST, abort
from restoring_kit import restore_from

PHASES = np.arange(16) / 16
TABLE = CorrectionTable(PHASES + 0.01 * np.sin(2 * np.pi * PHASES))
Receive = Callable[[Frame, float], list[Frame]]


def module() -> Bench:
    bench = Bench(sync=False, operational=False, store=MemoryStore(), config={"coast_samples": 5})
    put_in_force(bench.access, Correction(CorrectionTable.identity(16), Conditioning(sine_gain=1.25)))
    return bench


@cache
def backup() -> Backup:
    bench = Bench(sync=False, operational=False)
    put_in_force(bench.access, Correction(TABLE, Conditioning(sine_offset_counts=3.5)))
    bench.access.write(0x1017, 0, "H", 500)
    bench.access.write(0x2010, 2, "f", 12.5)
    return backup_of(bench.master, MODULE_ID, "2026-03-01")


def restore(bench: Bench) -> Restored:
    return restore_from(backup(), bench)


def wanted() -> dict[tuple[int, int], Any]:
    bench = module()
    restore(bench)
    return configuration_of(bench.module).values()


WANTED = wanted()
REQUESTS = 520
"""Of one restore, and a few more."""

FAULTS: dict[str, Callable[[Receive, Frame, float], list[Frame]]] = {
    "refused": lambda receive, frame, now: abort(frame),
    "request lost": lambda receive, frame, now: [],
    "answer lost": lambda receive, frame, now: [f for f in receive(frame, now) if f.can_id != ANSWER],
    "nonsense": lambda receive, frame, now: [Frame(ANSWER, b"\xff" * 8)],
}


@settings(max_examples=30)
@given(st.integers(1, REQUESTS), st.sampled_from(sorted(FAULTS)))
def test_one_request_that_fails(at: int, fault: str) -> None:
    bench = module()
    before = configuration_of(bench.module).values()
    receive, count = bench.module.receive, [0]

    def faulty(frame: Frame, now: float) -> list[Frame]:
        count[0] += frame.can_id == REQUEST
        if frame.can_id == REQUEST and count[0] == at:
            return FAULTS[fault](receive, frame, now)
        return receive(frame, now)

    bench.module.receive = faulty  # type: ignore[method-assign]
    said = refusal(bench)
    assert "\n" not in said
    assert "could not be put back" not in said
    assert configuration_of(bench.module).values() == (before if said else WANTED)
    if not said:
        assert bench.module.dictionary.entry(0x2020, 6).current() == TABLE.crc32, "saved"


def refusal(bench: Bench) -> str:
    """Why a restore has failed, "" if it has not."""
    try:
        restore(bench)
    except CanfbError as error:
        return str(error)
    return ""
