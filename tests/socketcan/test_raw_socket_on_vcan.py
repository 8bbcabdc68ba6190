"""The SocketCAN of our own on a real interface: what the kernel filters, stamps and reports."""

from __future__ import annotations

import errno
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from itertools import pairwise

import can
import pytest
from network import frame, frames
from pace import Pace

from canfb.bus.bus_state import ERROR_RESTARTED
from canfb.bus.frame_bus import ERROR, REMOTE, PythonCanBus, Received
from canfb.bus.opening import open_device_bus
from canfb.bus.raw_can_bus import RawCanBus
from canfb.bus.runner import Runner
from canfb.cia301.nmt import NmtState
from canfb.errors import BusError
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig

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


def test_no_frame_is_lost_while_filters_change(
    raw: RawCanBus, open_bus: Callable[..., can.BusABC], pace: Pace
) -> None:
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


def test_python_can_where_it_is_asked_for(can_channel: str) -> None:
    words = {"interface": "socketcan", "channel": can_channel}
    for more in ({"python_can": True}, {"fd": True}, {"can_filters": None, "local_loopback": False}):
        with open_device_bus(words | more) as bus:
            assert isinstance(bus, PythonCanBus)


def test_an_interface_that_there_is_not() -> None:
    with pytest.raises(
        BusError, match=r"^cannot open the bus socketcan nothing77: No such device; `ip link`"
    ):
        open_device_bus({"interface": "socketcan", "channel": "nothing77"})


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


class Ups:
    """A module on an interface that is down at its start, then up, removed, made again."""

    def __init__(self, pace: Pace) -> None:
        self._give_up_s = time.monotonic() + pace.patience_s
        self.lines: list[str] = []
        self.heard: list[tuple[int, bytes]] = []
        self.module = FeedbackModule(ModuleConfig(node_id=32, autostart=True))
        self._other: can.BusABC | None = None
        self._over = False
        self._steps = self._plan()
        self._ready = next(self._steps)

    def finished(self) -> bool:
        assert time.monotonic() < self._give_up_s, (self.lines, self.heard)
        while self._other is not None and (one := self._other.recv(0.0)) is not None:
            self.heard.append((one.arbitration_id, bytes(one.data)))
        if self._ready():
            self._ready = next(self._steps)
        return self._over

    def _plan(self) -> Iterator[Callable[[], bool]]:
        yield lambda: self.lines == ["the bus fails: Network is down"]
        ip("set", DOWN, "up")
        self._other = can.Bus(interface="socketcan", channel=DOWN)
        yield lambda: len(self.lines) == 2
        self._other.shutdown()
        self._other = None
        ip("del", "dev", DOWN)
        yield lambda: len(self.lines) == 3
        ip("add", "dev", DOWN, "type", "vcan")
        ip("set", DOWN, "up")
        self._other = can.Bus(interface="socketcan", channel=DOWN)
        yield lambda: len(self.lines) == 4 and (0x0A0, bytes(8)) in self.heard
        self._other.send(frame(0x000, bytes([0x80, 32])))  # the filters are those of the module again
        yield lambda: self.module.state is NmtState.PRE_OPERATIONAL
        self._other.shutdown()
        self._other = None
        self._over = True
        yield lambda: False


def test_a_module_outlives_its_interface(pace: Pace) -> None:
    """The first thing that it says is its boot-up, and it opens an interface of the same name again."""
    ip("add", "dev", DOWN, "type", "vcan")
    try:
        ups = Ups(pace)
        with open_device_bus({"interface": "socketcan", "channel": DOWN}) as bus:
            Runner(bus, [ups.module], ups.lines.append).run(ups.finished)
    finally:
        subprocess.run(["ip", "link", "del", "dev", DOWN], check=False)
    assert ups.heard[0] == (0x720, b"\0")
    assert [one for one in ups.heard if one[0] == 0x720] == [(0x720, b"\0")]
    assert ups.lines[1::2] == ["the bus works again"] * 2
    assert ups.lines[2] in ("the bus fails: Network is down", "the bus fails: No such device")
    assert (0x0A0, bytes.fromhex("4081110000000000")) in ups.heard


def test_frames_that_wait_while_the_host_stalls_are_there(
    raw: RawCanBus, can_bus: can.BusABC, pace: Pace
) -> None:
    """More than the 277 that a socket holds as delivered."""
    for number in range(400):
        can_bus.send(can.Message(arbitration_id=0x100 + number, is_extended_id=False))
    assert len(heard(raw, pace, 0x100 + 399)) == 400
