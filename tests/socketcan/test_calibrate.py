"""`canfb calibrate` against `canfb run` and `canfb simulate`, three processes on a real bus."""

from __future__ import annotations

import json
import signal
import zlib
from collections.abc import Callable
from pathlib import Path

import can
from network import (
    INTERFACE_ID,
    NODE_ID,
    POSITION_COB_ID,
    TIMES,
    Syncs,
    next_frame,
    position_fields,
    slow_motion,
    tolerate_late_syncs,
    wait_for_boot_up,
    write_config,
)
from pace import Pace

from canfb.objects import StatusBit
from processes import Process

SAMPLES = 500
ENCODER = """{amplitude: 0.7, sine_offset: 0.05, cosine_offset: -0.03, cosine_amplitude: 0.94,
            phase_error_rad: 0.05, harmonics: [{order: 3, sine: 0.01, cosine: 0.008}]}"""
MOTION = "{standstill_s: 0.02, ramp_s: 0.15, rpm: 155, ripple_rpm: 2.5, ripple_hz: 3.0}"


def test_a_table_is_measured_proven_and_reported_and_ctrl_c_takes_it_back(
    process: Callable[..., Process],
    tmp_path: Path,
    open_bus: Callable[..., can.BusABC],
    can_channel: str,
    pace: Pace,
) -> None:
    def table_is_active() -> bool:
        bus = open_bus()  # one that was open before would still hold old positions
        return bool(position_fields(next_frame(bus, pace, POSITION_COB_ID))[1] & StatusBit.TABLE_ACTIVE)

    bus = open_bus()
    config = write_config(tmp_path, f"{TIMES}    autostart: true\n", slow_motion(pace, MOTION, ENCODER))
    process("run", config)
    process("simulate", config)
    wait_for_boot_up(bus, pace, NODE_ID, INTERFACE_ID)
    tolerate_late_syncs(bus, pace)
    with Syncs(can_channel, pace) as syncs:
        syncs.wait(200)
        # Until there are so many samples; the time is only that after which six times as long is too long.
        seconds = str(min(600.0, max(1.0, SAMPLES / syncs.rate_hz)))
        calibrate = (
            "calibrate", "-i", "socketcan", "-c", can_channel, "--timeout", str(pace.answer_s),
            str(NODE_ID), "--seconds", seconds, "--least-samples", str(SAMPLES),
            "--entries", "256",
        )  # fmt: skip
        interrupted = process(*calibrate, "--verify", "600")
        interrupted.wait_for("verifying on fresh samples")
        assert table_is_active()
        interrupted.send(signal.SIGINT)
        assert interrupted.wait() == 130
        assert interrupted.lines[-2:] == [
            "... the previous table and conditioning are active in module 32 (20h)",
            "canfb: interrupted; nothing more is written to the module",
        ]
        assert not table_is_active()

        out = tmp_path / "out"
        command = process(*calibrate, "--verify", seconds, "--out", str(out), "--json")
        assert command.wait() == 0, str(command)
        assert table_is_active()
    figures = json.loads("\n".join(command.lines))
    assert figures["accepted"]
    assert figures["active"]
    assert figures["before_rms_cycles"] > 0.005
    assert 1e-6 < figures["fresh_rms_cycles"] < 3e-4
    assert figures["sample_rate_hz"] > 0
    table = (out / "table.bin").read_bytes()
    assert f"{zlib.crc32(table):08X}" == figures["crc32"]
    assert "Accepted." in (out / "report.html").read_text()
