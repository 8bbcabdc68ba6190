"""`canfb run` without its interface: at its start, with the link down, and where it comes back as another.

A listener is bound to an interface that is down: it hears the first frame that is sent when it is up.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import pytest
from network import (
    INTERFACE_ID,
    NODE_ID,
    POSITION_COB_ID,
    SYNC,
    TIMES,
    frame,
    frames,
    next_frame,
    position_fields,
    slow_motion,
    start_command,
    tolerate_late_syncs,
    write_config,
)
from pace import Pace
from test_interface_comes_back import ip

from canfb.objects import StatusBit
from processes import Process

BOOT_UP, EMERGENCY, MASTER = 0x700 + NODE_ID, 0x080 + NODE_ID, 0x7F
BUS_BACK, CONSUMER_LOST = b"\x40\x81", b"\x30\x81"
GONE = "the bus fails: .*(Network is down|No such device)"
BACK = "the bus works again"
STANDS = "{standstill_s: 0.0, ramp_s: 0.0, rpm: 0}"
QUICK_MS = 50
CLOSE_UNITS = 400  # of 8192 in a cycle


def link_down(channel: str) -> None:
    ip("set", channel, "down")


def removed(channel: str) -> None:
    """As an adapter that is unplugged: it comes back under another index, down."""
    ip("del", "dev", channel)


@contextlib.contextmanager
def up(channel: str) -> Iterator[can.BusABC]:
    """A listener, and then the link is up: all that is sent is heard."""
    if not Path("/sys/class/net", channel).exists():
        ip("add", "dev", channel, "type", "vcan")
    with can.Bus(interface="socketcan", channel=channel) as bus:
        with contextlib.suppress(can.CanError):
            bus.recv(0.0)  # that it is down is said once
        ip("set", channel, "up")
        yield bus


@pytest.fixture(autouse=True)
def up_at_the_end(can_channel: str) -> Iterator[None]:
    yield
    with up(can_channel):
        """Whatever has failed."""


def heard(bus: can.BusABC, pace: Pace, can_id: int, start: bytes) -> None:
    """Until a frame with this CAN-ID begins so."""
    for message in frames(bus, pace, f"{can_id:03X}#{start.hex()}"):
        if message.arbitration_id == can_id and message.data.startswith(start):
            return


def position(bus: can.BusABC, pace: Pace) -> int:
    """That of the next SYNC that is valid."""
    while True:
        bus.send(SYNC)
        units, status, _ = position_fields(next_frame(bus, pace, POSITION_COB_ID))
        if status & StatusBit.VALID:
            return units


def watch_heartbeat(bus: can.BusABC, pace: Pace, period_ms: int) -> None:
    """1016h:01, and a first heartbeat, from which the time counts."""
    entry = struct.pack("<BHBI", 0x23, 0x1016, 1, MASTER << 16 | period_ms)
    bus.send(frame(0x600 + NODE_ID, entry))
    heard(bus, pace, 0x580 + NODE_ID, b"\x60\x16\x10\x01")
    bus.send(frame(0x700 + MASTER, b"\x05"))


def test_an_outage_has_one_line_an_emcy_and_a_reason_for_each_state(
    process: Callable[..., Process], tmp_path: Path, can_channel: str, pace: Pace
) -> None:
    config = write_config(tmp_path, f"{TIMES}    autostart: true\n", slow_motion(pace, STANDS))
    link_down(can_channel)
    run = process("run", config)
    run.wait_for(GONE)
    with up(can_channel) as bus:
        heard(bus, pace, BOOT_UP, b"\0")
        run.wait_for(BACK)
        simulate = process("simulate", config)
        heard(bus, pace, 0x700 + INTERFACE_ID, b"\0")
        begin(bus, pace)
        before = position(bus, pace)
    for gone in (link_down, removed):
        gone(can_channel)
        for one in (run, simulate):
            one.wait_for(GONE)
        with up(can_channel) as bus:
            heard(bus, pace, EMERGENCY, BUS_BACK)
            for one in (run, simulate):
                one.wait_for(BACK)
            begin(bus, pace)
            assert abs(position(bus, pace) - before) < CLOSE_UNITS, "it stood all the time"
            run.wait_for("OPERATIONAL")
    with can.Bus(interface="socketcan", channel=can_channel) as bus:
        watch_heartbeat(bus, pace, QUICK_MS)
        heard(bus, pace, EMERGENCY, CONSUMER_LOST)
    reason = run.wait_for("PRE-OPERATIONAL")
    assert "8130h" in reason or "heartbeat" in reason, reason
    for one in (run, simulate):
        assert one.stop() == 0, one
        assert not any("a frame could not be sent" in line for line in one.lines), one
    assert [sum(word in line for line in run.lines) for word in ("the bus fails", BACK)] == [3, 3], run


def begin(bus: can.BusABC, pace: Pace) -> None:
    """What a master does after an outage."""
    tolerate_late_syncs(bus, pace)
    for message in start_command(NODE_ID, INTERFACE_ID):
        bus.send(message)
