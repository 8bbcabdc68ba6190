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
PERIODS = 13  # it stops where it began: a machine that moves in the pause of a reset is lost
STANDING = 20
LATE_PART = 0.25  # of a period


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
            give_up_s = time.monotonic() + pace.patience_s
            while not is_checked(master, can_bus, pace, *case):
                assert time.monotonic() < give_up_s, "no try in which all SYNCs were sent in time"


def is_checked(
    master: Master, bus: can.BusABC, pace: Pace, rpdo: int, tpdo: int, predict: int, behind: int
) -> bool:
    """Transmission types, 2013:01, and by how many samples the position is behind.

    False if a SYNC was sent late, which takes the valid bit: a busy machine does that, and tries again.
    """
    case = f"RPDO type {rpdo}, TPDO type {tpdo}, 2013:01 = {predict}"
    reset(bus, pace)
    sdo = master.module.sdo
    sdo[0x1400][2].raw, sdo[0x1800][2].raw, sdo[0x2013][1].raw = rpdo, tpdo, predict
    sdo[0x2010][6].raw = LATE
    for message in start_command(NODE_ID):
        bus.send(message)
    at_sync = tpdo == 1
    timer, sent_s, late = Timer(pace), [], False
    for number in range(PERIODS + STANDING):
        timer.wait()
        bus.send(SYNC)
        sent_s.append(time.monotonic())
        if number:
            late |= abs(sent_s[-1] - sent_s[-2] - timer.period_s) > LATE_PART * timer.period_s
        if at_sync:  # before there is another sample
            data = next_frame(bus, pace, POSITION_COB_ID)
        bus.send(sample(number, timer.period_s))
        if not at_sync:  # before there is another SYNC
            data = next_frame(bus, pace, POSITION_COB_ID)
        if 4 <= number < PERIODS:
            position, status, _ = position_fields(data)
            if not status & StatusBit.VALID:
                assert late, case
                continue
            # A prediction goes by the period as received, which a busy machine makes uneven.
            spare = QUARTER_UNITS // 8 if predict and at_sync else 0
            assert abs(position - (number - behind) * QUARTER_UNITS) <= spare, case
            assert bool(status & StatusBit.EXTRAPOLATED) == bool(predict and at_sync), case
    return not late
