"""A module on vcan, recorded by `canfb log record`: the replay sends every PDO of it again, byte for byte."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path

import can
import pytest
from network import (
    NODE_ID,
    POSITION_COB_ID,
    TIMES,
    next_frame,
    slow_motion,
    tolerate_late_syncs,
    wait_for_boot_up,
    write_config,
)
from pace import Pace

from processes import Process

POSITIONS = 100
PDOS = (f"{POSITION_COB_ID:03X}h", f"{POSITION_COB_ID + 0x100:03X}h")


@pytest.mark.parametrize("suffix", ["log", "blf"])
def test_every_pdo_comes_again(
    process: Callable[..., Process], tmp_path: Path, can_bus: can.BusABC, pace: Pace, suffix: str
) -> None:
    motion = slow_motion(pace, "{standstill_s: 0.01, ramp_s: 0.5, rpm: 60}")
    config = write_config(tmp_path, f"{TIMES}    autostart: true\n", motion)
    log = tmp_path / f"bus.{suffix}"
    record = process("log", "record", str(log), "--config", config)
    record.wait_for("recording socketcan vcan0")
    run = process("run", config)
    wait_for_boot_up(can_bus, pace, NODE_ID)
    tolerate_late_syncs(can_bus, pace)
    simulate = process("simulate", config, "--rate", f"{1.0 / pace.period_s:.3g}")
    for _ in range(POSITIONS):
        next_frame(can_bus, pace, POSITION_COB_ID)
    for one in (simulate, run, record):
        one.send(signal.SIGINT)
        assert one.wait() == 0
    replay = process("log", "replay", str(log), "--config", config, "--json")
    assert replay.wait() == 0, str(replay)
    (module,) = json.loads("\n".join(replay.lines))["modules"]
    for can_id in PDOS:
        found = module["compared"][can_id]
        assert found["different"] == found["only_recorded"] == found["only_replayed"] == 0, found
        assert found["equal"] >= POSITIONS // 2, "a missed sample has a position PDO, and no SYNC"
