"""A module that samples itself, through libiio's local backend: sysfs tree, character device, trigger."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from ctypes.util import find_library
from pathlib import Path

import can
import pytest
from emulated_iio_tree import position_cycles
from network import (
    NODE_ID,
    POSITION_COB_ID,
    SYNC,
    Timer,
    position_fields,
    skip_unless_required,
    tolerate_late_syncs,
    wait_for_boot_up,
    write_config,
)
from pace import Pace

from canfb.objects import StatusBit
from processes import Process

TREE = Path(__file__).with_name("emulated_iio_tree.py")
SOURCE = """\
    autostart: true
    source: {kind: iio, device: ads7950, trigger: sysfstrig0, wait_us: 1000000, buffer_scans: 8}
"""
UNITS_PER_CYCLE, RANGE_CYCLES = 8192, 209 * 2500
SYNCS, UNANSWERED_S = 400, 3.0


def with_adc(period_ms: float) -> list[str]:
    """In a mount namespace of its own, with the rights that it takes."""
    namespace = ["unshare", "--mount"] if os.geteuid() == 0 else ["unshare", "--map-root-user", "--mount"]
    return [*namespace, sys.executable, str(TREE), str(period_ms)]


@pytest.fixture(autouse=True)
def libiio() -> None:
    if find_library("iio") is None:
        skip_unless_required("no libiio; run: apt-get install libiio0")


def position_pdo(can_bus: can.BusABC) -> bytes | None:
    """The next one; None where a SYNC had no scan.

    The module waits a second for its scan: a machine that stands still for so long costs the sample.
    """
    while (message := can_bus.recv(UNANSWERED_S)) is not None:
        if message.arbitration_id == POSITION_COB_ID:
            return bytes(message.data)
    return None


def test_each_sync_fires_the_trigger_and_its_position_is_right(
    tmp_path: Path, can_bus: can.BusABC, command: Callable[..., Process], pace: Pace
) -> None:
    config = write_config(tmp_path, SOURCE)
    run = command(*with_adc(1e3 * pace.period_s), sys.executable, "-m", "canfb", "run", config)
    wait_for_boot_up(can_bus, pace, NODE_ID)
    tolerate_late_syncs(can_bus, pace)
    timer, answered = Timer(pace), 0
    for number in range(SYNCS):
        timer.wait()
        can_bus.send(SYNC)
        data = position_pdo(can_bus)
        units, status, _ = (0, 0, 0) if data is None else position_fields(data)
        if not status & StatusBit.VALID:
            break
        error = units / UNITS_PER_CYCLE - position_cycles(number)
        assert abs((error + RANGE_CYCLES / 2) % RANGE_CYCLES - RANGE_CYCLES / 2) < 0.02, number
        answered += 1
    assert position_cycles(SYNCS) > 50
    assert run.stop() == 0
    # A sample that has no scan in time is all that may cost the position.
    missed = "0" if answered == SYNCS else r"\d+"
    run.wait_for(rf"node 32: \d+ samples; missed {missed}, residual 0, amplitude 0, ")
