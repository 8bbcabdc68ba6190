"""The tracks of a real encoder, played onto the bus, tracked by the module, compared with their own index."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import can
import numpy as np
import pytest
from network import (
    ADC_COB_ID,
    INTERFACE_ID,
    NODE_ID,
    POSITION_COB_ID,
    SYNC,
    frame,
    position_fields,
    start_command,
    wait_for_boot_up,
    write_config,
)
from pace import Pace

from canfb.signal.supervision import StatusBit
from processes import Process

FOLDER = Path(os.environ.get("CANFB_RECORDINGS", Path(__file__).parents[3] / "shared" / "data"))
RECORDING = FOLDER / "servoproject_optical_encoder.csv"
GAP_S, INDEX_RANGE, UNITS_PER_CYCLE = 0.1, 2048, 8192
MODULE_ANSWER, INTERFACE_ANSWER = 0x580 + NODE_ID, 0x580 + INTERFACE_ID
MID_SCALE, RADIUS = 8192, 4000
# The ellipse that the recording's description gives, track b as the sine.
CONDITIONING = f"""\
    adc_bits: 14
    conditioning:
      sine_offset_counts: {12910 - MID_SCALE}
      cosine_offset_counts: {9593 - MID_SCALE}
      sine_gain: {RADIUS / 3132}
      cosine_gain: {RADIUS / 5251}
      phase_error_rad: {math.radians(14.6)}
"""


class Row(NamedTuple):
    time_s: float
    index: int


def read_rows() -> list[Row]:
    with RECORDING.open(newline="") as file:
        return [Row(float(row["t_s"]), int(row["fw_index"])) for row in csv.DictReader(file)]


def segments_of(rows: list[Row]) -> list[list[Row]]:
    """Stretches between the gaps, without the last sample before each gap."""
    cuts = [0, *(n for n, (a, b) in enumerate(pairwise(rows), 1) if b.time_s - a.time_s > GAP_S), len(rows)]
    parts = [rows[a : b - (b < len(rows))] for a, b in pairwise(cuts)]
    return [part for part in parts if part]


def positions_of_a_sync(bus: can.BusABC, pace: Pace) -> Iterator[bytes]:
    """Position PDOs until one answers the sample of this SYNC, or until it is clear that none will come.

    Whoever has answered a request has taken what came before it: the interface the SYNC, then the module the
    sample that the interface may have sent.
    """
    sampled, asked = False, [MODULE_ANSWER, INTERFACE_ANSWER]
    while True:
        message = bus.recv(0.1 if len(asked) == 2 else pace.patience_s)
        if message is None or message.arbitration_id == asked[-1]:
            assert message is not None or len(asked) == 2, "a node does not answer any more"
            if message is not None:
                asked.pop()
            if not asked:
                return
            bus.send(frame(asked[-1] + 0x80, bytes.fromhex("4000100000000000")))
            continue
        sampled = sampled or message.arbitration_id == ADC_COB_ID
        if message.arbitration_id == POSITION_COB_ID:
            yield bytes(message.data)
            if sampled and len(asked) == 2 and not position_fields(bytes(message.data))[1] & StatusBit.MISSED:
                return


def play(bus: can.BusABC, pace: Pace, rows: int) -> list[list[tuple[int, int]]]:
    """SYNC by SYNC through the recording: position and status of every sample, by segment.

    As a master would, the module is started anew when it says that the position is lost.
    """
    played: list[list[tuple[int, int]]] = [[]]
    count = 0
    while count < rows:
        bus.send(SYNC)
        for data in positions_of_a_sync(bus, pace):
            position, status, _ = position_fields(data)
            if not status & StatusBit.MISSED:
                played[-1].append((position, status))
                count += 1
            elif status & StatusBit.LOST:
                played.append([])
                bus.send(can.Message(arbitration_id=0, data=[0x80, NODE_ID], is_extended_id=False))
                bus.send(start_command(NODE_ID)[0])
    return [part for part in played if part]


@pytest.mark.skipif(not RECORDING.exists(), reason="no recording here; CANFB_RECORDINGS names its folder")
def test_the_published_cycles_agree_with_the_index_over_every_segment(
    process: Callable[..., Process], tmp_path: Path, can_bus: can.BusABC, pace: Pace
) -> None:
    config = write_config(tmp_path, CONDITIONING)
    process("run", config)
    process(
        "simulate", config, "--samples", str(RECORDING), "--columns", "b,a", "--mid-scale", str(MID_SCALE),
        "--time-column", "t_s", "--gap-samples", "6",
    )  # fmt: skip
    wait_for_boot_up(can_bus, pace, NODE_ID, INTERFACE_ID)
    for message in start_command(NODE_ID, INTERFACE_ID):
        can_bus.send(message)
    segments = segments_of(read_rows())
    played = play(can_bus, pace, sum(map(len, segments)))
    assert [len(part) for part in played] == [len(part) for part in segments]
    assert len(segments) == 25
    print("\nsegment  samples  cycles    index   largest deviation, cycles")
    for number, (part, rows) in enumerate(zip(played, segments, strict=True), 1):
        position = np.unwrap([p for p, _ in part], period=2500 * UNITS_PER_CYCLE * 209) / UNITS_PER_CYCLE
        index = np.unwrap([row.index for row in rows], period=INDEX_RANGE) / INDEX_RANGE
        deviation = (position - position[0]) - (index - index[0])
        worst = np.abs(deviation - np.median(deviation)).max()
        moved, counted = position[-1] - position[0], index[-1] - index[0]
        print(f"{number:7} {len(part):8} {moved:8.2f} {counted:8.2f} {worst:8.3f}")
        assert all(status & StatusBit.VALID for _, status in part)
        assert abs(deviation[-1]) < 0.25
        assert 0.001 < worst < 0.25
