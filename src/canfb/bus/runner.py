"""Devices on a python-can bus: frames in, frames out, deadlines kept, a clean end on a signal."""

from __future__ import annotations

import contextlib
import signal
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import FrameType
from typing import Protocol
from uuid import uuid4

import can

from canfb.bus.computing import Computation, Computing
from canfb.bus.opening import brings_own_frames_back, reason
from canfb.device.frame import Frame

LONGEST_WAIT_S = 0.1  # how late a signal may be noticed
RETRY_S = 0.2  # between attempts on a bus that is down
SETTLED_S = 1.0  # without a failure, before a bus is said to work again


class Device(Protocol):
    """A sans-I/O device, as FeedbackModule and EncoderInterface are."""

    def start(self, now: float) -> list[Frame]:
        """Power-on at ``now``."""

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Take a frame."""

    def tick(self, now: float) -> list[Frame]:
        """Do what is due."""

    def deadline(self) -> float | None:
        """When tick is wanted."""


@dataclass
class BusCounters:
    """What went over the bus, and what went wrong there."""

    received: int = 0
    sent: int = 0
    send_failures: int = 0
    error_frames: int = 0
    bus_failures: int = 0


class _Direction:
    """Sending or receiving: reports a failure once, and that it is over once that has lasted."""

    def __init__(self, report: Callable[[str], None], trouble: str, recovered: str) -> None:
        self._report = report
        self._trouble = trouble
        self._recovered = recovered
        self._failed_s: float | None = None

    def failed(self, error: Exception, now: float) -> bool:
        """Note a failure; True if the one before was only just now."""
        before, self._failed_s = self._failed_s, now
        if before is None:
            self._report(f"{self._trouble}: {reason(error)}")
        return before is not None and now - before < RETRY_S

    def worked(self, now: float) -> None:
        """Note that it worked."""
        if self._failed_s is not None and now - self._failed_s >= SETTLED_S:
            self._failed_s = None
            self._report(self._recovered)


class Runner:
    """Runs devices on one bus in the calling thread until :meth:`stop`.

    Devices of one process hear each other as well. A bus that fails is tried again; what
    happened is counted and told to ``report``, one line each time it changes. ``clock`` and
    ``sleep`` are those of the system, but for tests.
    """

    def __init__(
        self,
        bus: can.BusABC,
        devices: list[Device],
        report: Callable[[str], None] = lambda text: None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.counters = BusCounters()
        self._bus = bus
        self._devices = devices
        self._clock = clock
        self._sleep = sleep
        self._stopped = False
        self._receiving = _Direction(report, "the bus fails", "the bus works again")
        self._sending = _Direction(report, "a frame could not be sent", "frames can be sent again")
        self._computations = [
            (device, Computation(device, report)) for device in devices if isinstance(device, Computing)
        ]
        # Such a bus carries the channel of a message along: it shows which frames are ours.
        self._mark = uuid4().hex if brings_own_frames_back(bus) else None

    def stop(self) -> None:
        """End :meth:`run`; may be called from a signal handler or another thread."""
        self._stopped = True

    def run(self, finished: Callable[[], bool] = lambda: False) -> None:
        """Power the devices on and serve them until :meth:`stop`, or until ``finished()``."""
        for device in self._devices:
            self._spread(device, device.start(self._clock()))
        try:
            while not self._stopped and not finished():
                message = self._next_message()
                if message is not None:
                    self._take(message)
                self._tick()
                self._compute()
        finally:
            for _, computation in self._computations:
                computation.close()

    def _next_message(self) -> can.Message | None:
        deadlines = [deadline for device in self._devices if (deadline := device.deadline()) is not None]
        wait = LONGEST_WAIT_S
        if deadlines:
            wait = min(wait, max(0.0, min(deadlines) - self._clock()))
        try:
            message = self._bus.recv(wait)
        except (can.CanError, OSError) as error:
            self.counters.bus_failures += 1
            if self._receiving.failed(error, self._clock()):
                self._sleep(RETRY_S)
            return None
        if message is not None:
            self._receiving.worked(self._clock())
        return message

    def _take(self, message: can.Message) -> None:
        if self._mark is not None and message.channel == self._mark:
            return
        if message.is_error_frame:
            self.counters.error_frames += 1
            return
        if message.is_extended_id or message.is_fd:
            return  # CANopen uses 11-bit identifiers; others may share the bus
        self.counters.received += 1
        frame = Frame(message.arbitration_id, bytes(message.data), message.is_remote_frame, message.timestamp)
        now = self._clock()
        for device in self._devices:
            self._spread(device, device.receive(frame, now))

    def _tick(self) -> None:
        now = self._clock()
        for device in self._devices:
            deadline = device.deadline()
            if deadline is not None and deadline <= now:
                self._spread(device, device.tick(now))

    def _compute(self) -> None:
        """Give what a device wants computed to another process, without waiting for it."""
        for device, computation in self._computations:
            frames = computation.poll(self._clock())
            if frames:
                self._spread(device, frames)

    def _spread(self, sender: Device, frames: list[Frame]) -> None:
        """Send frames, and give them to the other devices of this process as well."""
        queue = deque((sender, frame) for frame in frames)
        while queue:
            origin, frame = queue.popleft()
            self._send(frame)
            for device in self._devices:
                if device is not origin:
                    queue.extend((device, answer) for answer in device.receive(frame, self._clock()))

    def _send(self, frame: Frame) -> None:
        message = can.Message(
            arbitration_id=frame.can_id,
            data=frame.data,
            is_remote_frame=frame.rtr,
            is_extended_id=False,
            channel=self._mark,
        )
        try:
            self._bus.send(message)
        except (can.CanError, OSError) as error:
            self.counters.send_failures += 1
            self._sending.failed(error, self._clock())
        else:
            self.counters.sent += 1
            self._sending.worked(self._clock())


@contextlib.contextmanager
def ending_on_signals(stop: Callable[[], None]) -> Iterator[None]:
    """Call ``stop`` on Ctrl-C and SIGTERM; the handlers before are put back at the end."""

    def handle(number: int, frame: FrameType | None) -> None:
        stop()

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
