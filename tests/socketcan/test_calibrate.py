"""`canfb calibrate` against `canfb run` and `canfb simulate`, three processes on a real bus."""

from __future__ import annotations

import json
import signal
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest
from network import NODE_ID, next_frame, position_fields, write_config

from canfb.signal.supervision import StatusBit

RATE_HZ = 200
AUTOSTART = "    autostart: true\n    times: true\n"
TURNING = """\
simulation:
  encoder: {amplitude: 0.7, sine_offset: 0.05, cosine_offset: -0.03, cosine_amplitude: 0.94,
            phase_error_rad: 0.05, harmonics: [{order: 3, sine: 0.01, cosine: 0.008}]}
  motion: {standstill_s: 0, ramp_s: 0, rpm: 31, ripple_rpm: 0.5, ripple_hz: 0.3}
"""
STANDING = TURNING.replace("rpm: 31, ripple_rpm: 0.5, ripple_hz: 0.3", "rpm: 0")
# A machine under load may keep an SDO answer waiting.
BUS = ("-i", "socketcan", "-c", "vcan0", "--answer-within", "5")


def machine(process: Callable[..., Any], folder: Path, simulation: str) -> None:
    config = write_config(folder, AUTOSTART, simulation)
    process("run", config).wait_for("end with Ctrl-C")
    process("simulate", config, "--rate", str(RATE_HZ)).wait_for("end with Ctrl-C")


def status(bus: can.BusABC) -> int:
    """Status word of the next position PDO; a bus opened before would still hold old ones."""
    data = next_frame(bus, 0x180 + NODE_ID)
    assert data is not None
    return position_fields(data)[1]


def sdo_write(index: int, subindex: int, value: int) -> list[can.Message]:
    """An expedited download of an UNSIGNED32 to the module."""
    data = struct.pack("<BHBI", 0x23, index, subindex, value)
    return [can.Message(arbitration_id=0x600 + NODE_ID, data=data, is_extended_id=False)]


def test_a_table_is_measured_uploaded_proven_and_reported(
    process: Callable[..., Any], tmp_path: Path, open_bus: Callable[..., can.BusABC]
) -> None:
    machine(process, tmp_path, TURNING)
    out = tmp_path / "out"
    command = process(
        "calibrate", *BUS, "--module", str(NODE_ID), "--seconds", "5", "--verify", "2", "--entries", "256",
        "--least-samples", "1000", "--out", str(out), "--json",
    )  # fmt: skip
    assert command.wait(60.0) == 0, str(command)
    figures = json.loads("\n".join(command.lines))
    assert figures["accepted"]
    assert figures["active"]
    assert figures["before_rms_cycles"] > 0.005
    assert 1e-6 < figures["fresh_rms_cycles"] < 3e-4
    assert abs(figures["sample_rate_hz"] - RATE_HZ) < 0.05 * RATE_HZ
    table = (out / "table.bin").read_bytes()
    assert f"{zlib.crc32(table):08X}" == figures["crc32"]
    assert "Accepted." in (out / "report.html").read_text()
    assert status(open_bus()) & StatusBit.TABLE_ACTIVE


def test_a_machine_that_stands_still_is_refused_and_nothing_changes(
    process: Callable[..., Any], tmp_path: Path, open_bus: Callable[..., can.BusABC]
) -> None:
    machine(process, tmp_path, STANDING)
    command = process("calibrate", *BUS, "--seconds", "2", "--least-samples", "200")
    assert command.wait(60.0) == 1
    assert command.lines[-1].startswith("canfb: the tracks hardly change: the machine stands still")
    assert not status(open_bus()) & StatusBit.TABLE_ACTIVE


@pytest.mark.parametrize("module", ["32", "33"])
def test_without_a_sync_or_without_the_module_it_says_so(
    process: Callable[..., Any], tmp_path: Path, module: str
) -> None:
    process("run", write_config(tmp_path)).wait_for("end with Ctrl-C")
    command = process("calibrate", *BUS, "--module", module, "--seconds", "2")
    assert command.wait(60.0) == 1
    said = (
        "canfb: no SYNC (080h) for 2 s: "
        if module == "32"
        else "canfb: module 33 (21h): reading 2020:04: no answer"
    )
    assert command.lines[-1].startswith(said)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_a_signal_while_the_new_table_is_being_proven_brings_the_old_one_back(
    process: Callable[..., Any], tmp_path: Path, open_bus: Callable[..., can.BusABC], number: signal.Signals
) -> None:
    machine(process, tmp_path, TURNING)
    command = process("calibrate", *BUS, "--seconds", "4", "--least-samples", "700", "--verify", "60")
    command.wait_for("verifying on fresh samples", 60.0)
    assert status(open_bus()) & StatusBit.TABLE_ACTIVE
    command.send(number)
    assert command.wait(30.0) == 1
    assert command.lines[-2:] == [
        "... the table and the conditioning from before are active in module 32 (20h)",
        "canfb: interrupted; the module is as it was",
    ]
    assert not status(open_bus()) & StatusBit.TABLE_ACTIVE


def test_the_module_measures_by_itself(
    process: Callable[..., Any], tmp_path: Path, can_bus: can.BusABC
) -> None:
    machine(process, tmp_path, TURNING)
    for message in (*sdo_write(0x1006, 0, 1_000_000 // RATE_HZ), *sdo_write(0x2030, 0x0A, 900)):
        can_bus.send(message)
    command = process(
        "calibrate", *BUS, "--source", "module", "--verify", "2", "--least-samples", "400", "--json"
    )
    assert command.wait(90.0) == 0, str(command)
    figures = json.loads("\n".join(command.lines))
    assert figures["active"]
    assert figures["fresh_rms_cycles"] < 3e-4
