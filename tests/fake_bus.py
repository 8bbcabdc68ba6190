"""A bus and a clock without hardware and without waiting: time passes where the runner waits."""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import can
import pytest

from canfb.bus.frame_bus import ERROR, EXTENDED, REMOTE, FrameBus, PythonCanBus, Received
from canfb.bus.raw_can_bus import RawCanBus
from canfb.cia301.frame import Frame

CAN_FRAME = struct.Struct("=IB3x8s")


class FakeClock:
    """Seconds that pass only when somebody waits."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.slept: list[float] = []

    def __call__(self) -> float:
        return self.now

    def sleep(self, duration_s: float) -> None:
        self.slept.append(duration_s)
        self.now += duration_s


class FakeBus:
    """What comes from it is planned, as (seconds from the start, message or error); what is sent is kept."""

    def __init__(self, clock: FakeClock, plan: Sequence[tuple[float, can.Message | Exception]] = ()) -> None:
        self.clock = clock
        self.start = clock.now
        self.plan = list(plan)
        self.sent: list[tuple[float, can.Message]] = []
        self.waits: list[float] = []
        self.end_s = float("inf")
        self.refuse: Callable[[float], Exception | None] = lambda at: None

    @property
    def at(self) -> float:
        """Seconds since the start, rounded to what a plan is written in."""
        return round(self.clock.now - self.start, 9)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        assert timeout is not None
        assert timeout >= 0.0
        self.waits.append(timeout)
        if self.plan and self.plan[0][0] <= min(self.at + timeout, self.end_s):
            due, item = self.plan.pop(0)
            self.clock.now = max(self.clock.now, self.start + due)
            if isinstance(item, Exception):
                raise item
            return item
        self.clock.now = min(self.clock.now + timeout, self.start + self.end_s)
        return None

    def send(self, message: can.Message) -> None:
        error = self.refuse(self.at)
        if error is not None:
            raise error
        self.sent.append((self.at, message))

    def shutdown(self) -> None:
        """Nothing is open."""

    def sent_ids(self) -> list[int]:
        return [message.arbitration_id for _, message in self.sent]


@dataclass
class FakeDevice:
    """Notes what it is asked; answers and ticks as it is told."""

    clock: FakeClock
    period_s: float | None = None
    answer: Callable[[Frame], list[Frame]] = lambda frame: []
    tick_id: int = 0x080
    boot: tuple[Frame, ...] = ()
    heard: list[tuple[float, Frame]] = field(default_factory=list)
    ticked: list[float] = field(default_factory=list)
    next_s: float | None = None

    def start(self, now: float) -> list[Frame]:
        self.next_s = None if self.period_s is None else now + self.period_s
        return list(self.boot)

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        assert now <= self.clock.now
        self.heard.append((now, frame))
        return self.answer(frame)

    def tick(self, now: float, until: float = float("inf")) -> list[Frame]:
        assert self.next_s is not None
        assert self.period_s is not None
        assert min(now, until) >= self.next_s, "never early"
        self.ticked.append(now - self.next_s)
        self.next_s += self.period_s
        return [Frame(self.tick_id, b"")]

    def deadline(self) -> float | None:
        return self.next_s

    def heard_ids(self) -> list[int]:
        return [frame.can_id for _, frame in self.heard]


def message(can_id: int, data: bytes = b"", **rest: object) -> can.Message:
    words: Any = {"is_extended_id": False, **rest}
    return can.Message(arbitration_id=can_id, data=data, **words)


class WiredBus:
    """A FakeBus at the other end of a pair of sockets: what is planned and sent goes through a RawCanBus."""

    def __init__(self, fake: FakeBus) -> None:
        ours, self._far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._raw = RawCanBus(ours)
        self._fake = fake

    def receive(self, wait_s: float) -> Received | None:
        planned = self._fake.recv(wait_s)
        if planned is None:
            return self._raw.receive(0.0)
        if planned.is_fd:
            return EXTENDED, b"", 0.0
        self._far.send(packed(planned))
        received = self._raw.receive(0.0)
        assert received is not None
        return (*received[:2], planned.timestamp)

    def send(self, can_id: int, data: bytes, remote: bool) -> bool:
        assert self._raw.send(can_id, data, remote)
        self._fake.send(unpacked(self._far.recv(CAN_FRAME.size)))
        return True

    def accept(self, can_ids: Iterable[int] | None, remote_can_ids: Iterable[int]) -> None:
        self._raw.accept(can_ids, remote_can_ids)

    def __enter__(self) -> WiredBus:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        self._raw.__exit__(None, None, None)
        self._far.close()


def packed(sent: can.Message) -> bytes:
    """A struct can_frame."""
    flags = ERROR * sent.is_error_frame | EXTENDED * sent.is_extended_id | REMOTE * sent.is_remote_frame
    return CAN_FRAME.pack(sent.arbitration_id | flags, sent.dlc, bytes(sent.data))


def unpacked(frame: bytes) -> can.Message:
    """What a struct can_frame says."""
    can_id, length, data = CAN_FRAME.unpack(frame)
    return can.Message(
        arbitration_id=can_id & 0x1FFF_FFFF,
        is_remote_frame=bool(can_id & REMOTE),
        is_extended_id=bool(can_id & EXTENDED),
        dlc=length,
        data=None if can_id & REMOTE else data[:length],
    )


_wired: list[WiredBus] | None = None


@pytest.fixture(autouse=True, params=["python-can", "raw socket"])
def each_kind_of_bus(request: pytest.FixtureRequest) -> Iterator[None]:
    """Import it into a file of tests: each of them then runs on both kinds of FrameBus."""
    global _wired
    _wired = [] if request.param == "raw socket" else None
    yield
    for one in _wired or ():
        one.close()
    _wired = None


def frame_bus(fake: Any) -> FrameBus:
    """The fake bus for a runner, by the kind of bus that the test runs on; python-can's if it has none."""
    if _wired is None:
        return PythonCanBus(fake)
    _wired.append(WiredBus(fake))
    return _wired[-1]
