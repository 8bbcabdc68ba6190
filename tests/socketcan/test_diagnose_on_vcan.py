"""`canfb why --bundle` and SIGUSR1 on a real CAN interface: both files say the same of the same node."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
from network import NODE_ID, wait_for_boot_up, write_config
from pace import Pace

from processes import Process

LIMITS = [f"2010:{subindex:02X}" for subindex in range(1, 13)]


def read(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found


def test_the_command_and_the_process_agree(
    process: Callable[..., Process], tmp_path: Path, can_bus: can.BusABC, pace: Pace
) -> None:
    state = tmp_path / "state"
    config = write_config(tmp_path, f"    residual_limit: 0.25\n    state_dir: {state}\n")
    run = process("run", config)
    wait_for_boot_up(can_bus, pace, NODE_ID)
    out = tmp_path / "machine.json"
    options = "--out", str(out), "--seconds", "0.5", "--timeout", str(pace.answer_s)
    asked = process("why", "--bundle", str(NODE_ID), config, *options)
    asked.wait_for(f"written  {out}")
    run.send(signal.SIGUSR1)
    run.wait_for(f"diagnosis written: {state}/canfb-diagnose-{run.pid}.json")
    by_sdo, by_itself = read(out), read(state / f"canfb-diagnose-{run.pid}.json")
    assert any("vcan0" in line for line in by_sdo["bus"]["interface"])
    assert by_itself["bus"]["words"] == {"interface": "socketcan", "channel": "vcan0"}
    assert by_itself["configuration"] == by_sdo["configuration"]
    (module,), (itself,) = by_sdo["nodes"], by_itself["nodes"]
    assert module["node_id"] == itself["node_id"] == NODE_ID
    assert [itself["objects"][one] for one in LIMITS] == [module["objects"][one] for one in LIMITS]
    assert itself["objects"]["2010:01"] == 16384
    assert set(module["objects"]) == set(itself["objects"])
    assert by_itself["bus"]["counters"]["received"] > 300
    assert any("boot-up, PRE-OPERATIONAL" in line for line in by_itself["log"])
    assert run.stop() == 0
