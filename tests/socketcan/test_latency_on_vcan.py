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
STILL = 10  # a start in motion needs even SYNCs, until the period is known
PERIODS = 13  # it stops where it began: a machine that moves in the pause of a reset is lost
STANDING = 20
SPARE_PART = 0.125  # of a period, of a position that is predicted to its SYNC
FEWEST = 3  # predicted positions that are compared


def sample(number: int, period_s: float) -> can.Message:
    """The ADC PDO of a machine that stands, turns a quarter of a cycle in each period, and stands again."""
    place = min(max(0, number - STILL), PERIODS - 1) % 4
    return frame(ADC_COB_ID, struct.pack("<hhI", *QUARTERS[place], round(number * period_s * 1e7)))


CASES = [(255, 254, 0, 0), (255, 254, 1, 0), (255, 1, 0, 1), (255, 1, 1, 0), (1, 1, 0, 1), (1, 1, 2, 0)]


def test_the_sample_of_each_position_pdo(
    process: Callable[..., Process], tmp_path: Path, can_channel: str, can_bus: can.BusABC, pace: Pace
) -> None:
    config = write_config(tmp_path, TIMES)
    module = process("run", config)
    wait_for_boot_up(can_bus, pace, NODE_ID)
    with Master(can_channel, pace) as master:
        for case in CASES:
            give_up_s = time.monotonic() + pace.patience_s
            while not is_checked(master, can_bus, pace, *case):
                assert time.monotonic() < give_up_s, f"no try in which all positions were valid: {case}"
                module.stop()  # a position that was lost is lost after a reset, too
                module = process("run", config)
                wait_for_boot_up(can_bus, pace, NODE_ID)


def is_checked(
    master: Master, bus: can.BusABC, pace: Pace, rpdo: int, tpdo: int, predict: int, behind: int
) -> bool:
    """Transmission types, 2013:01, and by how many samples the position is behind.

    False if a position was not valid, as after a SYNC or a sample that a busy machine sent late: try again. A
    prediction goes by the period as received: it is compared until the first SYNC that was uneven.
    """
    case = f"RPDO type {rpdo}, TPDO type {tpdo}, 2013:01 = {predict}"
    reset(bus, pace)
    sdo = master.module.sdo
    sdo[0x1400][2].raw, sdo[0x1800][2].raw, sdo[0x2013][1].raw = rpdo, tpdo, predict
    sdo[0x2010][6].raw = LATE
    for message in start_command(NODE_ID):
        bus.send(message)
    at_sync, predicted = tpdo == 1, bool(predict) and tpdo == 1
    timer, sent_s, all_valid, uneven, compared = Timer(pace), [], True, False, 0
    for number in range(STILL + PERIODS + STANDING):
        timer.wait()
        bus.send(SYNC)
        sent_s.append(time.monotonic())
        if number:
            off = abs(sent_s[-1] - sent_s[-2] - timer.period_s) / timer.period_s
            uneven = uneven or off > SPARE_PART
        if at_sync:  # before there is another sample
            data = next_frame(bus, pace, POSITION_COB_ID)
        bus.send(sample(number, timer.period_s))
        if not at_sync:  # before there is another SYNC
            data = next_frame(bus, pace, POSITION_COB_ID)
        if STILL + 4 <= number < STILL + PERIODS:
            position, status, _ = position_fields(data)
            if not status & StatusBit.VALID:
                all_valid = False
                continue
            if predicted and uneven:
                continue
            spare = SPARE_PART * QUARTER_UNITS if predicted else 0
            assert abs(position - (number - STILL - behind) * QUARTER_UNITS) <= spare, case
            assert bool(status & StatusBit.EXTRAPOLATED) == predicted, case
            compared += 1
    return all_valid and compared >= FEWEST
