"""Tasks over a real bus, each command a process: calibrate, backup and restore, DCF, record and replay."""

import json
import signal
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import canopen
import pytest
from network import (
    INTERFACE_ID,
    NODE_ID,
    POSITION_COB_ID,
    TIMES,
    Master,
    OpenBus,
    Syncs,
    next_frame,
    position_fields,
    slow_motion,
    tolerate_late_syncs,
    wait_for_boot_up,
    write_config,
)
from pace import Pace

from canfb import Conditioning, StatusBit
from canfb.sdo.tables import as_yaml
from canfb.signal.correction import Correction
from commissioning_kit import TABLE
from processes import Process, Started

NODE = str(NODE_ID)


@pytest.fixture
def task(process: Started, can_channel: str, pace: Pace) -> Started:
    """Starts a command that is a master of the bus."""
    options = ("-i", "socketcan", "-c", can_channel, "--timeout", str(pace.answer_s))
    return lambda *arguments: process(*arguments, *options)


@pytest.fixture
def canfb(task: Started) -> Callable[..., str]:
    """Such a command that succeeds; what it says."""

    def run(*arguments: Any) -> str:
        command = task(*map(str, arguments))
        assert command.wait() == 0, str(command)
        return str(command)

    return run


@pytest.fixture
def module(process: Started, tmp_path: Path, can_bus: can.BusABC, pace: Pace) -> Started:
    """Starts the module with these keys; it has booted."""

    def run(text: str = "") -> Process:
        while can_bus.recv(0.0) is not None:
            pass
        started = process("run", write_config(tmp_path, text))
        wait_for_boot_up(can_bus, pace, NODE_ID)
        return started

    return run


SAMPLES = 500
ENCODER = """{amplitude: 0.7, sine_offset: 0.05, cosine_offset: -0.03, cosine_amplitude: 0.94,
            phase_error_rad: 0.05, harmonics: [{order: 3, sine: 0.01, cosine: 0.008}]}"""
MOTION = "{standstill_s: 0.02, ramp_s: 0.15, rpm: 155, ripple_rpm: 2.5, ripple_hz: 3.0}"


def test_a_table_is_measured_proven_and_reported_and_ctrl_c_takes_it_back(
    process: Started, task: Started, tmp_path: Path, open_bus: OpenBus, can_channel: str, pace: Pace
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
            "calibrate",
            NODE,
            "--seconds",
            seconds,
            "--least-samples",
            str(SAMPLES),
            "--entries",
            "256",
        )
        interrupted = task(*calibrate, "--verify", "600")
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
        command = task(*calibrate, "--verify", seconds, "--out", str(out), "--json")
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


def test_a_module_is_backed_up_changed_and_restored(
    module: Started, canfb: Callable[..., str], tmp_path: Path, can_channel: str, pace: Pace
) -> None:
    table, backup = tmp_path / "table.yaml", tmp_path / "backup.yaml"
    table.write_text(as_yaml(Correction(TABLE, Conditioning(sine_gain=1.25)), {}))
    module(f"    state_dir: {tmp_path / 'state'}\n")
    canfb("table", "write", NODE, table, "--activate")
    canfb("sdo", "write", NODE, "samples to coast", "9")
    canfb("backup", "save", NODE, backup)
    canfb("table", "clear", NODE, "--conditioning")
    canfb("sdo", "write", NODE, "samples to coast", "4")
    assert "saved (1010:01)" in canfb("backup", "restore", backup, "--save")
    with Master(can_channel, pace) as master:
        sdo = master.module.sdo
        assert (sdo[0x2020][4].raw, sdo[0x2020][6].raw) == (TABLE.crc32, TABLE.crc32)
        assert (sdo[0x2010][3].raw, sdo[0x2002][3].raw) == (9, 1.25)
        assert sdo.upload(0x2020, 1) == TABLE.to_bytes()


OTHERWISE = """\
    adc_bits: 16
    cycles_per_revolution: 1024
    coast_samples: 9
    conditioning: {sine_offset_counts: 40.5, cosine_gain: 1.0371}
"""


def content(path: Path) -> str:
    """The DCF without its name and its date."""
    return path.read_text().partition("[DeviceInfo]")[2].replace(f"{path.stem}.table.bin", "table.bin")


def test_a_module_is_read_and_another_one_becomes_it(
    module: Started, canfb: Callable[..., str], tmp_path: Path, can_channel: str, pace: Pace
) -> None:
    def read(name: str) -> None:
        """From the running module into a DCF and its concise form."""
        files = "--out", tmp_path / f"{name}.dcf", "--concise", tmp_path / f"{name}.bin"
        canfb("config", "dcf", NODE, *files)

    first = module(OTHERWISE)
    with Master(can_channel, pace) as master:
        master.module.sdo.download(0x2020, 1, TABLE.to_bytes())
        master.module.sdo.download(0x2020, 3, TABLE.crc32.to_bytes(4, "little"))
    read("first")
    assert (tmp_path / "first.table.bin").read_bytes() == TABLE.to_bytes()
    assert first.stop() == 0

    module()
    with Master(can_channel, pace) as master:
        node = master.network.add_node(NODE_ID, canopen.import_od(str(tmp_path / "first.dcf")))
        node.sdo.RESPONSE_TIMEOUT = pace.patience_s
        node.load_configuration()
        assert node.sdo[0x2020][4].raw == TABLE.crc32
    read("second")
    assert content(tmp_path / "second.dcf") == content(tmp_path / "first.dcf")
    assert (tmp_path / "second.bin").read_bytes() == (tmp_path / "first.bin").read_bytes()


POSITIONS = 100
PDOS = (f"{POSITION_COB_ID:03X}h", f"{POSITION_COB_ID + 0x100:03X}h")


@pytest.mark.parametrize("suffix", ["log", "blf"])
def test_a_module_is_recorded_and_in_the_replay_every_pdo_comes_again(
    process: Started, tmp_path: Path, can_bus: can.BusABC, pace: Pace, suffix: str
) -> None:
    """Byte for byte."""
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
