"""`canfb run` and `canfb simulate` as processes of their own, with masters that are not ours."""

from __future__ import annotations

import queue
import re
import signal
from collections.abc import Callable
from pathlib import Path

import can
import pytest
from network import (
    ADC_COB_ID,
    INTERFACE_ID,
    NODE_ID,
    PERIODS,
    POSITION_COB_ID,
    TIMES,
    Master,
    Timer,
    next_frame,
    position_fields,
    reset,
    slow_motion,
    start_command,
    tolerate_late_syncs,
    wait_for_boot_up,
    write_config,
)
from pace import Pace

from canfb.objects import StatusBit
from ideal_tracks import wavy_table
from processes import Process

MOTION = "{standstill_s: 0.01, ramp_s: 0.5, rpm: 60}"


@pytest.fixture
def both(
    process: Callable[..., Process], tmp_path: Path, can_bus: can.BusABC, pace: Pace
) -> tuple[Process, Process]:
    """The module and the encoder interface, on the bus, in PRE-OPERATIONAL."""
    config = write_config(tmp_path, TIMES, slow_motion(pace, MOTION))
    started = process("run", config), process("simulate", config)
    wait_for_boot_up(can_bus, pace, NODE_ID, INTERFACE_ID)
    return started


def test_python_canopen_as_master_bad_frames_and_a_clean_end(
    both: tuple[Process, Process], open_bus: Callable[..., can.BusABC], can_channel: str, pace: Pace
) -> None:
    with Master(can_channel, pace) as master:
        starts_reads_uploads_and_hears(master, pace)
        bad_frames_are_told_or_dropped_and_change_nothing(master, open_bus(), pace)
    signals = signal.SIGINT, signal.SIGTERM
    words = r"node 32: \d+ samples", r"\d+ samples sent"
    for one, number, last_words in zip(both, signals, words, strict=True):
        one.send(number)
        assert one.wait() == 0
        assert re.search(last_words, one.lines[-1])
        assert not any("Traceback" in line for line in one.lines)


def starts_reads_uploads_and_hears(master: Master, pace: Pace) -> None:
    module = master.module
    assert module.sdo[0x1000].raw == 0x00040196
    assert master.interface.sdo[0x1000].raw == 0x00040191
    adc_cob_id = master.interface.sdo[0x1800][1].raw & 0x7FF
    module.sdo[0x1400][1].raw = 0x80000000 | adc_cob_id
    module.sdo[0x1400][1].raw = adc_cob_id
    heard: queue.Queue[tuple[int, int]] = queue.Queue()
    module.tpdo.read()
    module.tpdo[1].add_callback(lambda pdo: heard.put((pdo[0].raw, pdo[1].raw)))
    module.sdo[0x2010][6].raw = PERIODS
    for node in (module, master.interface):
        node.nmt.state = "OPERATIONAL"
    positions = []
    timer = Timer(pace)
    for _ in range(50):
        timer.wait()
        master.network.sync.transmit()
        position, status = heard.get(timeout=pace.patience_s)
        assert status & StatusBit.VALID
        positions.append(position)
    assert module.sdo[0x6004].raw == positions[-1]

    table = wavy_table(256)
    module.sdo.download(0x2020, 1, table.to_bytes())
    assert module.sdo[0x2020][2].raw == table.crc32
    module.sdo[0x2020][3].raw = table.crc32
    assert module.sdo[0x2020][4].raw == table.crc32
    assert module.sdo.upload(0x2020, 1) == table.to_bytes()
    timer.wait()
    master.network.sync.transmit()
    assert heard.get(timeout=pace.patience_s)[1] == StatusBit.VALID | StatusBit.TABLE_ACTIVE


def bad_frames_are_told_or_dropped_and_change_nothing(
    master: Master, can_bus: can.BusABC, pace: Pace
) -> None:
    reset(can_bus, pace)
    sdo = master.module.sdo
    for message in start_command(NODE_ID):
        can_bus.send(message)
    can_bus.send(can.Message(arbitration_id=ADC_COB_ID, data=[1, 2, 3, 4, 0, 0, 0, 0], is_extended_id=False))
    next_frame(can_bus, pace, POSITION_COB_ID)
    can_bus.send(can.Message(arbitration_id=ADC_COB_ID, data=[9], is_extended_id=False))
    next_frame(can_bus, pace, 0x80 + NODE_ID)
    can_bus.send(can.Message(arbitration_id=0x7FF, data=bytes(8), is_extended_id=False))
    can_bus.send(can.Message(arbitration_id=0x600 + NODE_ID, data=bytes(3), is_extended_id=False))
    can_bus.send(can.Message(arbitration_id=0x12345678, data=bytes(8), is_extended_id=True))
    assert (sdo[0x2000][1].raw, sdo[0x2000][2].raw) == (0x0201, 0x0403)
    assert sdo[0x2012][8].raw == 1


def test_the_simulator_can_produce_the_sync_and_the_other_signals(
    process: Callable[..., Process], tmp_path: Path, can_bus: can.BusABC, pace: Pace
) -> None:
    config = write_config(tmp_path, f"{TIMES}    autostart: true\n", slow_motion(pace, MOTION))
    run = process("run", config)
    wait_for_boot_up(can_bus, pace, NODE_ID)
    tolerate_late_syncs(can_bus, pace)
    simulate = process("simulate", config, "--rate", f"{1.0 / pace.period_s:.3g}")
    valid = 0
    while valid < 20:  # a process that gets no processor may miss some
        valid += position_fields(next_frame(can_bus, pace, POSITION_COB_ID))[1] & StatusBit.VALID
    for one, number in ((run, signal.SIGTERM), (simulate, signal.SIGINT)):
        one.send(number)
        assert one.wait() == 0


def test_a_bus_that_does_not_exist_is_one_line(process: Callable[..., Process], tmp_path: Path) -> None:
    run = process("run", write_config(tmp_path), "-c", "vcan77")
    assert run.wait() == 1
    assert run.lines == [
        "canfb: cannot open the bus socketcan vcan77: No such device; `ip link` lists the interfaces, "
        "docs/vcan.md explains how to create one"
    ]
