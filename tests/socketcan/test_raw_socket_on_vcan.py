"""The SocketCAN of our own on a real interface: what the kernel filters, stamps and reports."""

import errno
import subprocess
import threading
import time
from collections.abc import Iterator
from itertools import pairwise

import can
import pytest
from network import OpenBus, frame, frames
from pace import Pace

from canfb.bus.bus_state import ERROR_RESTARTED
from canfb.bus.frame_bus import ERROR, REMOTE, Received
from canfb.bus.opening import open_device_bus
from canfb.bus.raw_can_bus import RawCanBus

DOWN = "vcan9"


@pytest.fixture
def raw(can_channel: str) -> Iterator[RawCanBus]:
    bus = open_device_bus({"interface": "socketcan", "channel": can_channel})
    assert isinstance(bus, RawCanBus)
    with bus:
        yield bus


def heard(bus: RawCanBus, pace: Pace, until_id: int) -> list[Received]:
    """Frames up to the one with this CAN-ID."""
    got: list[Received] = []
    end = time.monotonic() + pace.patience_s
    while not any(can_id == until_id for can_id, _, _ in got):
        assert time.monotonic() < end, f"only {got}"
        one = bus.receive(0.1)
        got += [] if one is None else [one]
    return got


def test_it_hears_others_and_not_itself(raw: RawCanBus, can_bus: can.BusABC, pace: Pace) -> None:
    raw.send(0x1A0, b"\x01\x02", False)
    raw.send(0x720, b"", True)
    data, remote = (next(frames(can_bus, pace, "a frame of the raw socket")) for _ in range(2))
    assert bytes(data.data) == b"\x01\x02"
    assert remote.is_remote_frame
    before_s = time.time()
    can_bus.send(frame(0x080))
    can_bus.send(frame(0x190, b"\x01\x02\x03\x04"))
    can_bus.send(can.Message(arbitration_id=0x190, is_extended_id=True))
    can_bus.send(can.Message(arbitration_id=0x7FF, is_extended_id=False, is_remote_frame=True))
    got = heard(raw, pace, 0x7FF | REMOTE)
    assert [can_id for can_id, _, _ in got] == [0x080, 0x190, 0x8000_0190, 0x7FF | REMOTE]
    stamps = [stamp for _, _, stamp in got]
    assert before_s - 1e-3 <= stamps[0] <= stamps[-1] <= time.time() + 1e-3
    assert all(one <= other for one, other in pairwise(stamps))


def test_the_kernel_leaves_out_what_nobody_needs(raw: RawCanBus, can_bus: can.BusABC, pace: Pace) -> None:
    raw.accept({0x080, 0x190}, {0x720})
    for can_id in (0x081, 0x080, 0x191, 0x190, 0x720):
        can_bus.send(frame(can_id))
    can_bus.send(can.Message(arbitration_id=0x080, is_extended_id=True))
    can_bus.send(can.Message(arbitration_id=0x190, is_extended_id=False, is_remote_frame=True))
    can_bus.send(can.Message(arbitration_id=0x720, is_extended_id=False, is_remote_frame=True))
    assert [one for one, _, _ in heard(raw, pace, 0x720 | REMOTE)] == [0x080, 0x190, 0x720 | REMOTE]
    raw.accept(None, ())
    can_bus.send(frame(0x333))
    assert [one for one, _, _ in heard(raw, pace, 0x333)] == [0x333]


def test_no_frame_is_lost_while_filters_change(raw: RawCanBus, open_bus: OpenBus, pace: Pace) -> None:
    """Frames of one CAN-ID, numbered, while others come and go in the filter."""
    count = 300
    sender = open_bus()

    def send() -> None:
        for number in range(count):
            sender.send(frame(0x080, number.to_bytes(2, "little")))
            time.sleep(0)
        sender.send(frame(0x7F1))

    raw.accept({0x080, 0x7F1}, ())
    thread = threading.Thread(target=send)
    thread.start()
    numbers: list[int] = []
    changes, last = 0, False
    end = time.monotonic() + pace.patience_s
    while not last and time.monotonic() < end:
        changes += 1
        raw.accept({0x080, 0x7F1, *range(0x100, 0x100 + changes % 300)}, {0x720 + changes % 2})
        can_id, data, _ = raw.receive(0.001) or (0, b"", 0.0)
        last |= can_id == 0x7F1
        numbers += [int.from_bytes(data, "little")] * (can_id == 0x080)
    thread.join()
    assert numbers == list(range(count))
    assert changes > 3


def ip(*words: str) -> None:
    done = subprocess.run(["ip", "link", *words], capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"ip link {' '.join(words)}: {done.stderr.strip()}")


def test_an_interface_that_goes_down_is_an_error_and_works_again_when_it_is_up(pace: Pace) -> None:
    ip("add", "dev", DOWN, "type", "vcan")
    try:
        ip("set", DOWN, "up")
        words = {"interface": "socketcan", "channel": DOWN}
        with open_device_bus(words) as bus, can.Bus(interface="socketcan", channel=DOWN) as other:
            ip("set", DOWN, "down")
            with pytest.raises(OSError, match="Network is down") as caught:
                bus.receive(1.0)
            assert caught.value.errno == errno.ENETDOWN
            with pytest.raises(OSError, match="Network is down"):
                bus.send(0x1A0, b"", False)
            with pytest.raises(OSError, match="Network is down"):  # each time
                bus.receive(1.0)
            ip("set", DOWN, "up")
            assert bus.receive(1.0) == (ERROR | ERROR_RESTARTED, b"", 0.0)
            assert bus.send(0x1A0, b"", False)
            with pytest.raises(can.CanOperationError):  # what it had to tell before
                other.recv(1.0)
            other.send(frame(0x080))
            assert isinstance(bus, RawCanBus)
            assert [one for one, _, _ in heard(bus, pace, 0x080)] == [0x080]
    finally:
        ip("del", "dev", DOWN)


def test_frames_that_wait_while_the_host_stalls_are_there(
    raw: RawCanBus, can_bus: can.BusABC, pace: Pace
) -> None:
    """More than the 277 that a socket holds as delivered."""
    for number in range(400):
        can_bus.send(can.Message(arbitration_id=0x100 + number, is_extended_id=False))
    assert len(heard(raw, pace, 0x100 + 399)) == 400
