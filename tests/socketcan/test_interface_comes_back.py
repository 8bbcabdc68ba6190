"""An interface that goes down, or is removed and made again: who listens stays, and hears what comes then.

And `canfb run` without it: at its start, with the link down, and where it comes back as another. A listener
is bound to an interface that is down: it hears the first frame that is sent when it is up.
"""

import contextlib
import struct
import subprocess
from collections.abc import Iterator
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
    wait_for,
    wait_for_boot_up,
    write_config,
)
from pace import Pace

from canfb.objects import StatusBit
from processes import Process, Started

MARK = 0x123
AGAIN_S = 0.1  # from mark to mark: a quiet bus does not show that it works
IDENTIFY = bytes.fromhex("4000100000000000")  # SDO upload of 1000h
LISTENERS = {
    "record": "recording",
    "dump": f"{MARK:03X}",
    "monitor": "frames/s",
    "scope": "^open http",
    "run": "running",
}


def ip(*words: str) -> None:
    subprocess.run(["ip", "link", *words], check=True)


@contextlib.contextmanager
def down(channel: str) -> Iterator[None]:
    ip("set", channel, "down")
    try:
        yield
    finally:
        ip("set", channel, "up")


@contextlib.contextmanager
def removed(channel: str) -> Iterator[None]:
    """As an adapter that is unplugged: it comes back under another index."""
    ip("del", "dev", channel)
    try:
        yield
    finally:
        ip("add", "dev", channel, "type", "vcan")
        ip("set", channel, "up")


@contextlib.contextmanager
def marked(channel: str, number: int) -> Iterator[can.BusABC]:
    """Frames that are known again, from a bus that is opened now."""
    with can.Bus(interface="socketcan", channel=channel) as bus:
        bus.send_periodic(frame(MARK, bytes([number])), AGAIN_S)
        yield bus


@pytest.fixture
def listeners(
    process: Started, tmp_path: Path, can_channel: str, can_bus: can.BusABC, pace: Pace
) -> dict[str, Process]:
    """All of them, and each has begun."""
    where, log = ("-i", "socketcan", "-c", can_channel), str(tmp_path / "bus.log")
    started = {
        "record": process("log", "record", log, *where),
        "dump": process("monitor", "--frames", *where),
        "monitor": process("monitor", "--plain", "--updates", "0.5", *where, str(NODE_ID)),
        "scope": process("monitor", "--web", *where, str(NODE_ID)),
        "run": process("run", write_config(tmp_path)),
    }
    wait_for_boot_up(can_bus, pace, NODE_ID)
    with marked(can_channel, 0):
        for name, one in started.items():
            one.wait_for(LISTENERS[name])
    return started


def test_who_listens_outlasts_its_interface(
    listeners: dict[str, Process], tmp_path: Path, can_channel: str, pace: Pace
) -> None:
    for number, gone in enumerate((down, removed), start=1):
        with gone(can_channel):
            for one in listeners.values():
                one.wait_for("the bus fails: .*(Network is down|No such device)")
        with marked(can_channel, number) as bus:
            for one in listeners.values():
                one.wait_for("the bus works again")
            bus.send(frame(0x600 + NODE_ID, IDENTIFY))
            assert wait_for(bus, pace, 0x580 + NODE_ID)
            listeners["dump"].wait_for(f"{MARK:03X} .*{number:02X}")
    for name, one in listeners.items():
        assert one.stop() == 0, one
        for words in ("the bus fails", "the bus works again"):
            assert sum(words in line for line in one.lines) == 2, f"{name}: one line each time\n{one}"
    with can.LogReader(tmp_path / "bus.log") as log:
        assert {one.data[0] for one in log if one.arbitration_id == MARK} == {0, 1, 2}


BOOT_UP, EMERGENCY, MASTER = 0x700 + NODE_ID, 0x080 + NODE_ID, 0x7F
BUS_BACK, CONSUMER_LOST = b"\x40\x81", b"\x30\x81"
GONE = "the bus fails: .*(Network is down|No such device)"
BACK = "the bus works again"
STANDS = "{standstill_s: 0.0, ramp_s: 0.0, rpm: 0}"
QUICK_MS = 50
CLOSE_UNITS = 400  # of 8192 in a cycle


def link_down(channel: str) -> None:
    ip("set", channel, "down")


def unplugged(channel: str) -> None:
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
    process: Started, tmp_path: Path, can_channel: str, pace: Pace
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
    for gone in (link_down, unplugged):
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
