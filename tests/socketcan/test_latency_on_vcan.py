"""Which sample a position PDO carries, on a real bus: order only, no times."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest
from network import (
    ADC_COB_ID,
    NODE_ID,
    POSITION_COB_ID,
    SYNC,
    Master,
    next_frame,
    position_fields,
    start_command,
    write_config,
)

from canfb.signal.supervision import StatusBit

QUARTERS = ((0, 1500), (1500, 0), (0, -1500), (-1500, 0))
QUARTER_UNITS = 2048
PERIODS = 12


def sample(number: int) -> can.Message:
    """The ADC PDO of a machine that turns a quarter of a cycle in each period."""
    return can.Message(
        arbitration_id=ADC_COB_ID, data=struct.pack("<hh", *QUARTERS[number % 4]), is_extended_id=False
    )


@pytest.mark.parametrize(
    ("rpdo", "tpdo", "predict", "behind"),
    [(255, 254, 0, 0), (255, 254, 1, 0), (255, 1, 0, 1), (255, 1, 1, 0), (1, 1, 0, 1), (1, 1, 2, 0)],
)
def test_the_sample_of_each_position_pdo(
    process: Callable[..., Any],
    tmp_path: Path,
    can_channel: str,
    can_bus: can.BusABC,
    rpdo: int,
    tpdo: int,
    predict: int,
    behind: int,
) -> None:
    process("run", write_config(tmp_path)).wait_for("end with Ctrl-C")
    master = Master(can_channel)
    try:
        sdo = master.module.sdo
        sdo[0x1400][2].raw, sdo[0x1800][2].raw, sdo[0x2013][1].raw = rpdo, tpdo, predict
    finally:
        master.close()
    for message in start_command(NODE_ID):
        can_bus.send(message)
    at_sync = tpdo == 1
    for number in range(PERIODS):
        can_bus.send(SYNC)
        data = None
        if at_sync:  # before there is another sample
            data = next_frame(can_bus, POSITION_COB_ID)
            assert data is not None
        can_bus.send(sample(number))
        if not at_sync:  # before there is another SYNC
            data = next_frame(can_bus, POSITION_COB_ID)
        assert data is not None
        if number >= 4:
            position, status, _ = position_fields(data)
            assert position == (number - behind) * QUARTER_UNITS
            assert bool(status & StatusBit.EXTRAPOLATED) == bool(predict and at_sync)
            assert status & StatusBit.VALID
