"""The SocketCAN of our own on a pair of sockets, which carry the same frames: times, queues, filters."""

from __future__ import annotations

import errno
import os
import socket
import struct
import time
from collections.abc import Iterator

import pytest

from canfb.bus.clocks import LEARNED_FRAMES
from canfb.bus.dispatch import LONGEST_DELAY_S, LONGEST_QUEUE
from canfb.bus.frame_bus import ERROR, EXTENDED, REMOTE
from canfb.bus.raw_can_bus import MOST_FILTERS, FrameReader, RawCanBus
from canfb.bus.runner import Runner
from canfb.cia301.frame import Frame
from fake_bus import CAN_FRAME, FakeClock, FakeDevice

PATIENCE_S = 60.0


class Wire:
    """A bus of our own, and its far end."""

    def __init__(self) -> None:
        ours, self.far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.far.setblocking(False)
        self.bus = RawCanBus(ours)

    def put(self, can_id: int, data: bytes = b"") -> None:
        self.far.send(CAN_FRAME.pack(can_id, len(data), data))

    def sent(self) -> list[tuple[int, bytes]]:
        """What has come to the far end."""
        frames: list[tuple[int, bytes]] = []
        while True:
            try:
                can_id, length, data = CAN_FRAME.unpack(self.far.recv(CAN_FRAME.size))
            except BlockingIOError:
                return frames
            frames.append((can_id, data[:length]))

    def fill(self) -> int:
        """Send until the bus takes no more; how many it took."""
        count = 0
        while self.bus.send(0x700, bytes([count % 256]), False):
            count += 1
        return count


@pytest.fixture
def wire() -> Iterator[Wire]:
    made = Wire()
    with made.bus, made.far:
        yield made


def test_frames_come_in_their_order_with_flags_and_times(wire: Wire) -> None:
    flagged = [0x081 | ERROR, 0x1FFF_FFFF | EXTENDED, 0x7FF | REMOTE, 0x7FF, 0]
    sent = [(can_id, bytes(range(length))) for length, can_id in enumerate([0x190, 0x1A0, 0x1A1, *flagged])]
    before_s = time.time()
    for can_id, data in sent:
        wire.put(can_id, data)
    frames = [frame for _ in sent if (frame := wire.bus.receive(PATIENCE_S)) is not None]
    assert [frame[:2] for frame in frames] == sent
    stamps = [before_s - 1e-3, *(frame[2] for frame in frames), time.time() + 1e-3]
    assert stamps == sorted(stamps)
    assert wire.bus.receive(0.0) is None


@pytest.mark.parametrize("wait_s", [0.0, 0.0004, 0.0042])
def test_it_waits_no_longer_than_it_was_told(wire: Wire, wait_s: float) -> None:
    """It may come back earlier, by a part of a millisecond; the runner asks again."""
    start = time.perf_counter()
    assert wire.bus.receive(wait_s) is None
    assert time.perf_counter() - start >= min(wait_s, int(wait_s * 1000) / 1000 or wait_s) - 1e-5


def test_a_full_queue_is_no_wait_and_no_error(wire: Wire) -> None:
    count = wire.fill()
    assert count >= 1
    assert not wire.bus.send(0x1A0, b"", False)
    wire.put(0x080)
    assert wire.bus.receive(0.0) is not None, "it hears meanwhile"
    assert len(wire.sent()) == count
    assert wire.bus.send(0x1A0, b"", False)


def test_room_in_the_queue_ends_a_wait(wire: Wire) -> None:
    wire.fill()
    wire.sent()
    start = time.perf_counter()
    assert wire.bus.receive(PATIENCE_S) is None
    assert time.perf_counter() - start < PATIENCE_S / 2


class NoRoom:
    """The queue of an interface is full for the first frames; then a filter, a stamp or a send fails."""

    def __init__(self, wire: Wire, code: int) -> None:
        self.code, self._send = code, wire.bus._send
        wire.bus._send = self.send  # type: ignore[assignment]

    def send(self, data: bytes) -> int:
        if self.code:
            raise OSError(self.code, os.strerror(self.code))
        return self._send(data)


def test_a_full_interface_takes_it_later(wire: Wire) -> None:
    room = NoRoom(wire, errno.ENOBUFS)
    assert not wire.bus.send(0x1A0, b"", False)
    room.code = 0
    assert wire.bus.send(0x1A0, b"", False)


@pytest.mark.parametrize("code", [errno.ENETDOWN, errno.ENODEV, errno.ENXIO, errno.EPERM])
def test_an_interface_that_is_down_is_an_error(wire: Wire, code: int) -> None:
    NoRoom(wire, code)
    with pytest.raises(OSError, match=os.strerror(code)) as caught:
        wire.bus.send(0x1A0, b"", False)
    assert caught.value.errno == code


def test_a_bus_that_is_closed_cannot_be_read() -> None:
    wire = Wire()
    wire.far.close()
    with wire.bus:
        pass
    with pytest.raises((OSError, ValueError)):
        wire.bus.receive(0.0005)


class Line:
    """A runner on a wire, in a time of its own."""

    def __init__(self, wire: Wire) -> None:
        self.wire, self.clock = wire, FakeClock()
        self.lines: list[str] = []
        self.device = FakeDevice(self.clock, answer=lambda frame: [Frame(0x100 + n, b"") for n in range(5)])
        self.runner = Runner(wire.bus, [self.device], self.lines.append, self.clock, self.clock.sleep)
        self.rounds = 0

    def go(self, rounds: int, step_s: float = 0.001) -> None:
        self.rounds = rounds

        def finished() -> bool:
            self.clock.now += step_s
            self.rounds -= 1
            return self.rounds < 0

        self.runner.run(finished)


def test_the_order_is_kept_over_a_full_queue(wire: Wire) -> None:
    filled = wire.fill()
    line = Line(wire)
    wire.put(0x200)
    line.go(3)
    assert line.runner.counters.sent == 0
    assert len(wire.sent()) == filled
    line.go(10)
    assert [can_id for can_id, _ in wire.sent()] == [0x100, 0x101, 0x102, 0x103, 0x104]
    assert line.runner.counters.sent == 5
    assert line.lines == []


def test_frames_that_grow_old_are_given_up_and_reported_once(wire: Wire) -> None:
    filled = wire.fill()
    line = Line(wire)
    for _ in range(3):
        wire.put(0x200)
    line.go(14, step_s=LONGEST_DELAY_S / 8)
    assert len(wire.sent()) == filled, "nothing of what is old goes out"
    assert line.runner.counters.send_failures == 15
    assert line.lines == ["a frame could not be sent: No buffer space available"]


def test_the_queue_has_an_end(wire: Wire) -> None:
    wire.fill()
    line = Line(wire)
    line.device.answer = lambda frame: [Frame(0x100, b"")] * (LONGEST_QUEUE + 7)
    wire.put(0x200)
    line.go(2, step_s=1e-6)
    assert line.runner.counters.send_failures == 7
    assert len(line.lines) == 1


def test_the_time_of_the_hardware_is_taken_where_it_is(wire: Wire) -> None:
    """As the kernel writes it: SCM_TIMESTAMPNS, then SCM_TIMESTAMPING with the third of its times.

    Once the two clocks are known, the frame has the least delay; a frame without such a time has the other.
    """
    reader = FrameReader(wire.bus._socket)

    def late_s(true_s: float, delay_s: float, hardware: bool = True) -> float:
        kernel = struct.pack("@2l", *divmod(round((true_s + delay_s) * 1e9), 10**9))
        times = struct.pack("@6l", 0, 0, 0, 0, *divmod(round((true_s - 95.0) * 1e9), 10**9))
        controls = [(socket.SOL_SOCKET, 35, kernel)] + [(socket.SOL_SOCKET, 37, times)] * hardware
        reader._receive = lambda *arguments: (CAN_FRAME.pack(0x080, 0, b""), controls, 0, None)
        received = reader.read()
        assert received is not None
        return received[2] - true_s

    delays_s = [late_s(100.0 + 0.01 * n, 250e-6 if n % 3 else 40e-6) for n in range(3 * LEARNED_FRAMES)]
    assert delays_s[1] == pytest.approx(250e-6, abs=1e-6)
    assert delays_s[LEARNED_FRAMES + 1 :] == pytest.approx([40e-6] * (2 * LEARNED_FRAMES - 1), abs=5e-6)
    assert late_s(103.0, 90e-6, hardware=False) == pytest.approx(90e-6, abs=1e-6)


class Filters:
    """A CAN socket, as far as filters go."""

    def __init__(self) -> None:
        self.set: list[bytes] = []
        self.gone = False

    def setsockopt(self, level: int, option: int, value: bytes) -> None:
        if self.gone:
            raise OSError(errno.ENODEV, "No such device")
        self.set.append(value)


@pytest.mark.skipif(not hasattr(socket, "CAN_RAW_FILTER"), reason="python was built without SocketCAN")
def test_filters_are_exact_and_set_when_they_change(wire: Wire) -> None:
    kernel = Filters()
    wire.bus._is_can = True
    keeps, wire.bus._socket = wire.bus._socket, kernel  # type: ignore[assignment]
    wire.bus.accept({0x080, 0x190}, {0x1A0})
    wire.bus.accept({0x190, 0x080}, {0x1A0})
    mask = 0xC000_07FF
    assert kernel.set == [struct.pack("=6I", 0x080, mask, 0x190, mask, 0x1A0 | REMOTE, mask)]
    wire.bus.accept(None, ())
    assert kernel.set[1:] == [struct.pack("=II", 0, EXTENDED)], "all but 29-bit identifiers"
    wire.bus.accept(range(MOST_FILTERS), {0x1A0})
    assert len(kernel.set) == 2, "more than the kernel takes: all again"
    kernel.gone = True
    wire.bus.accept({0x080}, ())
    kernel.gone = False
    wire.bus.accept({0x080}, ())
    assert kernel.set[2:] == [struct.pack("=2I", 0x080, mask)], "an interface that is gone is told by reading"
    wire.bus._socket = keeps
