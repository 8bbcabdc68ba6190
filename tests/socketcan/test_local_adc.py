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
    next_frame,
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


def with_adc(period_ms: float) -> list[str]:
    """In a mount namespace of its own, with the rights that it takes."""
    namespace = ["unshare", "--mount"] if os.geteuid() == 0 else ["unshare", "--map-root-user", "--mount"]
    return [*namespace, sys.executable, str(TREE), str(period_ms)]


@pytest.fixture(autouse=True)
def libiio() -> None:
    if find_library("iio") is None:
        skip_unless_required("no libiio; run: apt-get install libiio0")


def test_each_sync_fires_the_trigger_and_its_position_is_right(
    tmp_path: Path, can_bus: can.BusABC, command: Callable[..., Process], pace: Pace
) -> None:
    config = write_config(tmp_path, SOURCE)
    run = command(*with_adc(1e3 * pace.period_s), sys.executable, "-m", "canfb", "run", config)
    wait_for_boot_up(can_bus, pace, NODE_ID)
    tolerate_late_syncs(can_bus, pace)
    timer = Timer(pace)
    for number in range(400):
        timer.wait()
        can_bus.send(SYNC)
        units, status, _ = position_fields(next_frame(can_bus, pace, POSITION_COB_ID))
        assert status & StatusBit.VALID
        error = units / UNITS_PER_CYCLE - position_cycles(number)
        assert abs((error + RANGE_CYCLES / 2) % RANGE_CYCLES - RANGE_CYCLES / 2) < 0.02, number
    assert position_cycles(400) > 50
    assert run.stop() == 0
    run.wait_for("node 32: 400 samples; missed 0, ")
