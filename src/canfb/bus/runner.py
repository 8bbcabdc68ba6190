"""Devices on a python-can bus: frames in, frames out, deadlines kept, a clean end on a signal."""

from __future__ import annotations

import contextlib
import logging
import signal
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from uuid import uuid4

import can

from canfb.bus.bus_state import RETRY_S, BusState, FailureWatch
from canfb.bus.computing import Computation
from canfb.bus.opening import brings_own_frames_back, marks_own_frames
from canfb.bus.receive_times import ReceiveTimes
from canfb.cia301.frame import Frame
from canfb.device.hosted import BusWatching, Computing, Device, Ending, Inhibited
from canfb.device.moment import NEVER
from canfb.errors import CanfbError

log = logging.getLogger(__name__)

POLL_S = 0.01  # from one look at the computations to the next
LONGEST_WAIT_S = 0.1  # how late a signal may be noticed
LEAST_WAIT_S = 2e-4  # what is not faster than that was waited for
LONGEST_DRAIN_S = 1.0  # how long frames that wait may put off a deadline
LONGEST_BLIND_DRAIN_S = 0.1  # where they have no receive times, and may have come after it


class DeviceFailure(CanfbError):
    """A program error in ``device``; what it raised is the cause."""

    def __init__(self, device: object, error: Exception) -> None:
        self.device = device
        super().__init__(f"program error: {_in_one_line(error)}")


@dataclass
class BusCounters:
    """What went over the bus, and what went wrong there."""

    received: int = 0
    sent: int = 0
    send_failures: int = 0
    error_frames: int = 0
    bus_failures: int = 0


class Runner:
    """Runs devices on one bus in the calling thread until :meth:`stop`.

    Devices of one process hear each other as well. A bus that fails is tried again; what
    happened is counted and reported to ``report``, one line each time it changes, and the devices
    that want to know hear when the bus goes and comes back. A device that raises ends
    :meth:`run` for all, with DeviceFailure: its state is unknown.

    Frames get the time at which the bus received them (:class:`ReceiveTimes`). A runner that comes
    round late takes all frames that wait before it looks at a deadline: SYNC and samples may be among
    them, and nothing was late then but the runner.

    ``meanwhile`` is called now and then with the time, some hundred times a second at most.
    ``clock``, ``sleep`` and ``wall`` (the time of day) are those of the system, but for tests.
    """

    def __init__(
        self,
        bus: can.BusABC,
        devices: list[Device],
        report: Callable[[str], None] = log.warning,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
        wall: Callable[[], float] = time.time,
        meanwhile: Callable[[float], None] = lambda now: None,
    ) -> None:
        self.counters = BusCounters()
        self._bus = bus
        self._devices = devices
        self._meanwhile = meanwhile
        self._clock = clock
        self._sleep = sleep
        self._times = ReceiveTimes(clock, wall)
        self._received_s: float | None = None  # when the last frame came, if frames may wait behind it
        self._longest_drain_s = LONGEST_DRAIN_S
        self._put_off_s: float | None = None  # since when frames that wait put off deadlines
        self._asked_s = clock()  # when a frame was asked for
        self._compute_s = -NEVER  # when to look for computations next
        self._stopped = False
        self._receiving = FailureWatch(report, "the bus fails", "the bus works again")
        self._sending = FailureWatch(report, "a frame could not be sent", "frames can be sent again")
        self._bus_state = BusState(report)
        self._computations = [
            (device, Computation(device, report)) for device in devices if isinstance(device, Computing)
        ]
        self._inhibited = {id(device): device for device in devices if isinstance(device, Inhibited)}
        self._alone = len(devices) == 1
        # Such a bus carries the channel of a message along: it shows which frames are ours.
        self._mark = uuid4().hex if brings_own_frames_back(bus) else None
        self._echoes = marks_own_frames(bus)

    def stop(self) -> None:
        """End :meth:`run`; may be called from a signal handler or another thread."""
        self._stopped = True

    def run(
        self, finished: Callable[[], bool] = lambda: False, ready: Callable[[], None] = lambda: None
    ) -> None:
        """Power the devices on and serve them until :meth:`stop`, or until ``finished()``.

        ``ready`` is called once, when they have been powered on and serve what comes from then on.
        """
        try:
            for device in self._devices:
                self._spread(device, self._asked(device, device.start, self._clock()))
            ready()
            while not self._stopped and not finished():
                due = NEVER  # as _due(), at each frame
                for device in self._devices:
                    deadline = device.deadline()
                    if deadline is not None and deadline < due:
                        due = deadline
                if due <= self._clock() and not self._waits_before(due):
                    self._tick()
                    due = self._due()
                message = self._next_message(due)
                if message is not None:
                    self._take(message)
                else:
                    self._emptied()
                if self._bus_state.gone:
                    self._tell_bus_state()
                if self._asked_s >= self._compute_s:
                    self._compute()
        finally:
            for _, computation in self._computations:
                computation.close()
            for device in self._devices:
                if isinstance(device, Ending):
                    device.end(self._clock())

    def _emptied(self) -> None:
        """No frame waits."""
        self._received_s = self._put_off_s = None
        self._times.emptied()

    def _waits_before(self, due: float) -> bool:
        """Frames that came before this deadline may still wait."""
        received = self._received_s
        if received is None or received >= due:
            self._put_off_s = None
            return False
        now = self._clock()
        if self._put_off_s is None:
            self._put_off_s = now
        return now - self._put_off_s < self._longest_drain_s

    def _due(self) -> float:
        """The earliest deadline of all devices, NEVER for none."""
        due = NEVER
        for device in self._devices:
            deadline = device.deadline()
            if deadline is not None and deadline < due:
                due = deadline
        return due

    def _next_message(self, due: float) -> can.Message | None:
        """Wait for a message until `due`, and not longer than a signal may wait."""
        self._asked_s = asked = self._clock()
        wait = min(LONGEST_WAIT_S, max(0.0, due - asked))
        try:
            message = self._bus.recv(wait)
        except (can.CanError, OSError) as error:
            self.counters.bus_failures += 1
            now = self._clock()
            self._bus_state.reading_failed(error, now)
            if self._receiving.failed(error, now):
                self._sleep(RETRY_S)
            return None
        if self._bus_state.troubled:
            is_frame = message is not None and not message.is_error_frame
            self._bus_state.reading_worked(self._clock(), frame=is_frame)
        if message is not None and self._receiving.failed_s is not None:
            self._receiving.worked(self._clock())
        return message

    def _take(self, message: can.Message) -> None:
        if self._mark is not None and message.channel == self._mark:
            return
        if self._echoes and not message.is_rx:
            return
        now = self._clock()
        if message.is_error_frame:
            self.counters.error_frames += 1
            self._bus_state.error_frame(message.arbitration_id, now)
            return
        if message.is_extended_id or message.is_fd:
            return  # CANopen uses 11-bit identifiers; others may share the bus
        self.counters.received += 1
        received = self._times.received(message.timestamp, now)
        if received is None:
            self._received_s = -NEVER
            self._longest_drain_s = LONGEST_BLIND_DRAIN_S
            waited_for = now - self._asked_s >= LEAST_WAIT_S
        else:
            self._received_s = received
            self._longest_drain_s = LONGEST_DRAIN_S
            waited_for = received >= self._asked_s
        if waited_for:
            self._put_off_s = None
        frame = Frame(message.arbitration_id, bytes(message.data), message.is_remote_frame, received)
        for device in self._devices:
            try:
                answers = device.receive(frame, now)
            except Exception as error:
                raise DeviceFailure(device, error) from error
            if self._alone:
                for answer in answers:
                    self._send(device, answer)
            elif answers:
                self._spread(device, answers)

    def _tick(self) -> None:
        now = self._clock()
        for device in self._devices:
            deadline = device.deadline()
            if deadline is not None and deadline <= now:
                self._spread(device, self._asked(device, device.tick, now))

    def _tell_bus_state(self) -> None:
        """Notify the devices when the bus has gone, and when it is back."""
        now = self._clock()
        lost, returned = self._bus_state.lost(), self._bus_state.returned(now)
        for device in self._devices:
            if isinstance(device, BusWatching):
                if lost:
                    self._spread(device, self._asked(device, device.bus_off, now))
                if returned:
                    self._spread(device, self._asked(device, device.bus_back, now))

    def _compute(self) -> None:
        """Give what a device wants computed to another process, without waiting for it.

        Few frames start or end a computation that takes seconds: it is looked for at this rate only.
        """
        self._compute_s = self._asked_s + POLL_S
        for device, computation in self._computations:
            frames = self._asked(device, computation.poll, self._clock())
            if frames:
                self._spread(device, frames)
        self._meanwhile(self._asked_s)

    def _asked(self, device: Device, method: Callable[[float], list[Frame]], now: float) -> list[Frame]:
        """What a method of the device gives; DeviceFailure for what it raises."""
        try:
            return method(now)
        except Exception as error:
            raise DeviceFailure(device, error) from error

    def _spread(self, sender: Device, frames: list[Frame]) -> None:
        """Send frames, and give them to the other devices of this process as well."""
        queue: deque[tuple[Device, Frame]] = deque()
        for frame in frames:
            queue.append((sender, frame))
        while queue:
            origin, frame = queue.popleft()
            self._send(origin, frame)
            now = self._clock()
            for device in self._devices:
                if device is not origin:
                    try:
                        answers = device.receive(frame, now)
                    except Exception as error:
                        raise DeviceFailure(device, error) from error
                    if answers:
                        queue.extend((device, answer) for answer in answers)

    def _send(self, sender: Device, frame: Frame) -> None:
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
            now = self._clock()
            self._bus_state.sending_failed(error, now)
            self._sending.failed(error, now)
        else:
            self.counters.sent += 1
            if self._bus_state.troubled:
                self._bus_state.sending_worked(self._clock())
            if self._sending.failed_s is not None:
                self._sending.worked(self._clock())
        inhibited = self._inhibited.get(id(sender))
        if inhibited is not None and frame.can_id in inhibited.inhibited:
            inhibited.sent(frame.can_id, self._clock())


def _in_one_line(error: Exception) -> str:
    """What was raised, and where."""
    text = " ".join(str(error).split())
    last = error.__traceback__
    while last is not None and last.tb_next is not None:
        last = last.tb_next
    where = "" if last is None else f" ({Path(last.tb_frame.f_code.co_filename).name}:{last.tb_lineno})"
    return f"{type(error).__name__}{': ' if text else ''}{text}{where}"


@contextlib.contextmanager
def ending_on_signals(stop: Callable[[], None]) -> Iterator[None]:
    """Call ``stop`` on Ctrl-C, SIGTERM and SIGHUP; the handlers before are put back at the end.

    SIGHUP comes when the terminal goes. Where it is ignored already (nohup) it stays so.
    """

    def handle(number: int, frame: FrameType | None) -> None:
        stop()

    endings = [signal.SIGINT, signal.SIGTERM]
    hangup = getattr(signal, "SIGHUP", None)  # not on every system
    if hangup is not None and signal.getsignal(hangup) is not signal.SIG_IGN:
        endings.append(hangup)
    before = {number: signal.signal(number, handle) for number in endings}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
