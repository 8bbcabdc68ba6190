"""The module measures its own reference on a real bus, with python canopen as the master."""

from __future__ import annotations

import queue
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import pytest
from network import (
    INTERFACE_ID,
    NODE_ID,
    POSITION_COB_ID,
    TIMES,
    Master,
    Timer,
    position_fields,
    slow_motion,
    tolerate_late_syncs,
    wait_for_boot_up,
    write_config,
)
from pace import Pace

from canfb.objects import StatusBit
from processes import Process

SAMPLES = 600
IDLE, RECORDING, COMPUTING, READY, REFUSED, ACCEPTED = range(6)
START, ACCEPT = 1, 3
ENCODER = "{sine_offset: 0.03, cosine_amplitude: 0.97, phase_error_rad: 0.05}"
MOTION = "{standstill_s: 0.025, ramp_s: 0.1, rpm: 7.4, ripple_rpm: 0.3, ripple_hz: 2.6}"


@pytest.fixture
def master(can_channel: str, pace: Pace) -> Iterator[Master]:
    with Master(can_channel, pace) as made:
        yield made


def test_measured_accepted_and_recorded_over_a_real_bus(
    process: Callable[..., Process], master: Master, can_bus: can.BusABC, tmp_path: Path, pace: Pace
) -> None:
    config = write_config(tmp_path, TIMES, slow_motion(pace, MOTION, ENCODER))
    for command in ("run", "simulate"):
        process(command, config)
    wait_for_boot_up(can_bus, pace, NODE_ID, INTERFACE_ID)
    tolerate_late_syncs(can_bus, pace)
    heard: queue.Queue[int] = queue.Queue()
    master.network.subscribe(
        POSITION_COB_ID, lambda can_id, data, timestamp: heard.put(position_fields(bytes(data))[1])
    )
    sdo, timer = master.module.sdo, Timer(pace)
    for node in (master.module, master.interface):
        node.nmt.state = "OPERATIONAL"

    def synchronise(count: int) -> list[int]:
        """That many SYNCs, each with its position: the status words."""
        words = []
        for _ in range(count):
            timer.wait()
            master.network.sync.transmit()
            words.append(heard.get(timeout=pace.patience_s))
        return words

    sdo[0x2030][10].raw = SAMPLES
    sdo[0x2050][1].raw = START
    sdo[0x2030][1].raw = START
    words = synchronise(SAMPLES // 2)
    assert (sdo[0x2030][2].raw, sdo[0x2030][3].raw) == (RECORDING, 40)
    words += synchronise(SAMPLES - SAMPLES // 2)
    give_up = time.monotonic() + 5.0 * pace.patience_s
    while sdo[0x2030][2].raw in (RECORDING, COMPUTING):
        assert time.monotonic() < give_up
        words += synchronise(10)
    assert all(word & StatusBit.VALID for word in words), "it goes on publishing, and what is right"
    assert all(word & StatusBit.CALIBRATING for word in words[:SAMPLES])
    assert (sdo[0x2030][2].raw, sdo[0x2030][7].raw) == (READY, 0)
    assert 0.0 < sdo[0x2030][5].raw < 5e-4
    assert sdo[0x2030][8].raw > 2e-3, "against the identity"
    assert sdo[0x2020][4].raw == 0
    sdo[0x2030][1].raw = ACCEPT
    assert (sdo[0x2030][2].raw, sdo[0x2030][8].raw) == (ACCEPTED, 0.0)
    # At once: a busy machine takes seconds for the table, and the position is lost without a SYNC.
    assert synchronise(1)[0] == StatusBit.VALID | StatusBit.TABLE_ACTIVE
    assert len(sdo.upload(0x2020, 1)) == 4 * sdo[0x2020][5].raw
    assert sdo[0x2020][4].raw != 0

    sdo[0x2050][1].raw = 2
    with sdo[0x2050][3].open("rb", block_transfer=True) as stream:
        data = stream.read()
    pairs = list(struct.iter_unpack("<hh", data))
    assert len(pairs) == sdo[0x2050][2].raw == len(words) + 1
    assert max(abs(sine) for sine, _ in pairs) > 1000
    assert (-32768, -32768) not in pairs
    assert sdo[0x2012][1].raw == 0, f"node {NODE_ID} missed nothing"
