"""An interface that goes down, or is removed and made again: who listens stays, and hears what comes then."""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import pytest
from network import NODE_ID, frame, wait_for, wait_for_boot_up, write_config
from pace import Pace

from processes import Process

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
    process: Callable[..., Process], tmp_path: Path, can_channel: str, can_bus: can.BusABC, pace: Pace
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
