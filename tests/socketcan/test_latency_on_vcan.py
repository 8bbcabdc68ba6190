"""Which sample a position PDO carries, on a real bus: order only, no times."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from pathlib import Path

import can
from network import (
    ADC_COB_ID,
    NODE_ID,
    POSITION_COB_ID,
    SYNC,
    TIMES,
    Master,
    Timer,
    frame,
    next_frame,
    position_fields,
    reset,
    start_command,
    wait_for_boot_up,
    write_config,
)
from network import (
    PERIODS as LATE,
)
from pace import Pace

from canfb.objects import StatusBit
from processes import Process

QUARTERS = ((0, 1500), (1500, 0), (0, -1500), (-1500, 0))
QUARTER_UNITS = 2048
PERIODS = 12
STANDING = 20  # a machine that moves at a reset is lost
LATE_PART, MEMORY = 0.25, 4  # of a period; SYNCs


def sample(number: int, period_s: float) -> can.Message:
    """The ADC PDO of a machine that turns a quarter of a cycle in each period, and then stands."""
    place = min(number, PERIODS - 1) % 4
    return frame(ADC_COB_ID, struct.pack("<hhI", *QUARTERS[place], round(number * period_s * 1e7)))


CASES = [(255, 254, 0, 0), (255, 254, 1, 0), (255, 1, 0, 1), (255, 1, 1, 0), (1, 1, 0, 1), (1, 1, 2, 0)]


def test_the_sample_of_each_position_pdo(
    process: Callable[..., Process], tmp_path: Path, can_channel: str, can_bus: can.BusABC, pace: Pace
) -> None:
    process("run", write_config(tmp_path, TIMES))
    wait_for_boot_up(can_bus, pace, NODE_ID)
    with Master(can_channel, pace) as master:
        for case in CASES:
            reset(can_bus, pace)
            check(master, can_bus, pace, *case)


def check(
    master: Master, bus: can.BusABC, pace: Pace, rpdo: int, tpdo: int, predict: int, behind: int
) -> None:
    """Transmission types, 2013:01, and by how many samples the position is behind."""
    case = f"RPDO type {rpdo}, TPDO type {tpdo}, 2013:01 = {predict}"
    sdo = master.module.sdo
    sdo[0x1400][2].raw, sdo[0x1800][2].raw, sdo[0x2013][1].raw = rpdo, tpdo, predict
    sdo[0x2010][6].raw = LATE
    for message in start_command(NODE_ID):
        bus.send(message)
    at_sync = tpdo == 1
    timer = Timer(pace)
    late, sent_s = (
        0,
        time.monotonic(),
    )  # a SYNC that a busy machine sends late takes the valid bit for a while
    for number in range(PERIODS + STANDING):
        timer.wait()
        bus.send(SYNC)
        before_s, sent_s = sent_s, time.monotonic()
        late = MEMORY if abs(sent_s - before_s - timer.period_s) > LATE_PART * timer.period_s else late - 1
        if at_sync:  # before there is another sample
            data = next_frame(bus, pace, POSITION_COB_ID)
        bus.send(sample(number, timer.period_s))
        if not at_sync:  # before there is another SYNC
            data = next_frame(bus, pace, POSITION_COB_ID)
        if 4 <= number < PERIODS:
            position, status, _ = position_fields(data)
            if not status & StatusBit.VALID:
                assert late > 0, case
                continue
            # A prediction goes by the period as received, which a busy machine makes uneven.
            spare = QUARTER_UNITS // 8 if predict and at_sync else 0
            assert abs(position - (number - behind) * QUARTER_UNITS) <= spare, case
            assert bool(status & StatusBit.EXTRAPOLATED) == bool(predict and at_sync), case
