"""Devices on a bus: frames in, frames out, deadlines kept, a clean end on a signal.

    keep the deadlines that are due (tick)
    wait for frames, until the next deadline, and 0.1 s at most: a signal sets a flag that is looked at here
    give each frame to the devices that listen to it (dispatch), send what they answer (frame_sender)

A process that did not run for a while finds deadlines in the past, and frames from before them in the queue.
So a deadline D is kept only if no frame received before D can wait: the last one was received at R >= D, or
the queue was empty at D or later. Frames put a deadline off by 1 s at most (0.1 s without receive times), so
that a flood cannot stop heartbeats.

A bus that fails is read again until it works. A device that raises ends the run for all: its state is
unknown.
"""

from __future__ import annotations

import contextlib
import gc
import logging
import signal
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import can

from canfb.bus.bus_state import BUS_FAILS, BUS_WORKS, BusState, FailureWatch, is_down
from canfb.bus.bus_state import RETRY_S as BUS_RETRY_S
from canfb.bus.clocks import LONGEST_DELAY_S, ReceiveTimes
from canfb.bus.computing import Computation
from canfb.bus.dispatch import Dispatch, Port
from canfb.bus.frame_bus import ERROR, EXTENDED, FrameBus, Received
from canfb.bus.frame_sender import RETRY_S, FrameSender
from canfb.cia301.frame import HIGHEST_ID, Frame
from canfb.device.core import NEVER
from canfb.device.device_protocol import BusWatching, Computing, Device, Ending
from canfb.errors import CanfbError

log = logging.getLogger(__name__)

POLL_S = 0.01  # from one look at the computations to the next
LONGEST_WAIT_S = 0.1  # how late a signal may be noticed
BUS_RESOLUTION_S = 0.001  # so much earlier a bus may end a wait that is longer
CLOSE_S = 1e-6  # a queue that is empty so shortly before a deadline is empty at it: rounding
LEAST_WAIT_S = 2e-4  # without receive times: a read that took so long has waited, and found no queue
LONGEST_DRAIN_S = 1.0  # how long frames that wait may put off a deadline
LONGEST_BLIND_DRAIN_S = 0.1  # where they have no receive times, and may have come after it

_new = tuple.__new__


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
    """Runs devices on one bus in the calling thread until :meth:`stop`; they hear each other.

    ``report`` gets one line when the state of the bus changes. DeviceFailure where a device raises.
    ``meanwhile`` is called some hundred times a second at most. ``busy_poll``: the bus is read without a
    wait.
    """

    def __init__(
        self,
        bus: FrameBus,
        devices: list[Device],
        report: Callable[[str], None] = log.warning,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
        wall: Callable[[], float] = time.time,
        meanwhile: Callable[[float], None] = lambda now: None,
        *,
        busy_poll: bool = False,
    ) -> None:
        self._bus = bus
        self._longest_wait_s = 0.0 if busy_poll else LONGEST_WAIT_S
        self._meanwhile = meanwhile
        self._clock = clock
        self._sleep = sleep
        self._dispatch = Dispatch(devices, bus)
        self._only = self._dispatch.ports[0] if len(devices) == 1 else None
        self._times = ReceiveTimes(clock, wall)
        self._due_s = NEVER  # the earliest deadline, when frames were asked for
        self._received = self._error_frames = self._bus_failures = 0
        self._received_s: float | None = None  # when the last frame came, if frames may wait behind it
        self._empty_s = -NEVER  # when no frame waited, as far as it is known
        self._longest_drain_s = LONGEST_DRAIN_S
        self._put_off_s: float | None = None  # since when frames that wait put off deadlines
        self._asked_s = self._now = clock()  # when frames were asked for; the last look at the clock
        self._compute_s = -NEVER  # when to look for computations next
        self._stopped = False
        self._receiving = FailureWatch(report, BUS_FAILS, BUS_WORKS)
        self._bus_state = BusState(report)
        self._sender = FrameSender(bus, clock, self._bus_state, report)
        self._owed_s = -NEVER  # when to try boot-ups that failed again
        self._off: set[Port] = set()  # whose devices know that the bus is gone
        self._computations = [
            (port, Computation(port.device, report))
            for port in self._dispatch.ports
            if isinstance(port.device, Computing)
        ]

    @property
    def counters(self) -> BusCounters:
        """What went over the bus until now."""
        sender = self._sender
        return BusCounters(
            self._received, sender.sent, sender.failures, self._error_frames, self._bus_failures
        )

    def stop(self) -> None:
        """End :meth:`run`; may be called from a signal handler or another thread."""
        self._stopped = True

    def run(
        self, finished: Callable[[], bool] = lambda: False, ready: Callable[[], None] = lambda: None
    ) -> None:
        """Power the devices on, call ``ready``, and serve them until :meth:`stop` or ``finished()``."""
        try:
            for port in self._dispatch.ports:
                self._spread(port, self._asked(port, port.device.start, self._clock()))
            ready()
            while not self._stopped and not finished():
                frames = self._wait()
                if frames:
                    if self._due_s > self._now or len(frames) == 1:
                        self._take(frames)
                    else:
                        self._take_overdue(frames)
                if self._bus_state.gone:
                    self._notify_bus_state()
                if self._sender.owed and self._now >= self._owed_s:
                    self._owed_s = self._now + BUS_RETRY_S
                    self._sender.retry_owed()
                if self._asked_s >= self._compute_s:
                    self._compute()
        finally:
            for _, computation in self._computations:
                computation.close()
            for port in self._dispatch.ports:
                if isinstance(port.device, Ending):
                    port.device.end(self._clock())

    def _wait(self) -> list[Received] | None:
        """Keep the deadlines; then wait for frames until the next one."""
        if self._dispatch.moved:
            self._dispatch.follow()
        self._now = asked = self._clock()
        if self._only is None:
            due = self._dispatch.due_s()
        else:  # the same, without a look at others
            deadline = self._only.device_deadline()
            due = NEVER if deadline is None else deadline
        if due <= asked:
            due = self._keep_deadlines(due)
            asked = self._now
        self._asked_s, self._due_s = asked, due
        wait = min(due - asked, self._longest_wait_s) if due > asked else 0.0
        if self._sender.waiting:
            wait = min(wait, RETRY_S)
        try:
            frames = self._bus.receive(wait)
        except (can.CanError, OSError) as error:
            self._reading_failed(error)
            frames = None
        else:
            self._now = now = self._clock()
            if self._bus_state.troubled:
                self._bus_state.reading_worked(now, frame=False)
            if frames and self._receiving.failed_s is not None:
                self._receiving.worked(now)
        if frames is None:
            self._received_s = self._put_off_s = None
            self._empty_s = asked + (wait if wait < BUS_RESOLUTION_S else wait - BUS_RESOLUTION_S)
            self._times.emptied()
        if self._sender.waiting:
            self._sender.retry(self._now)
        return frames

    def _keep_deadlines(self, due: float) -> float:
        """Tick what is due, unless earlier frames may wait; the next deadline."""
        if self._waits_before(due):
            return due
        self._tick()
        return self._dispatch.due_s()

    def _waits_before(self, due: float) -> bool:
        """Frames that came before this deadline may still wait."""
        received, now = self._received_s, self._now
        taken_s = self._empty_s + CLOSE_S if received is None else received
        if taken_s >= due:
            self._put_off_s = None
            return False
        if self._put_off_s is None:
            self._put_off_s = now
        return now - self._put_off_s < self._longest_drain_s

    def _reading_failed(self, error: Exception) -> None:
        self._bus_failures += 1
        self._now = now = self._clock()
        self._bus_state.reading_failed(error, now)
        if self._receiving.failed(error, now, known=is_down(error)):
            self._sleep(BUS_RETRY_S)

    def _take_overdue(self, frames: list[Received]) -> None:
        """As :meth:`_take`; a deadline may lie between two of these frames."""
        for number, frame in enumerate(frames):
            if number:
                due = self._dispatch.due_s()
                if due <= self._now:
                    self._keep_deadlines(due)
            self._take([frame])

    def _take(self, frames: list[Received]) -> None:
        """Give frames of one call of the bus to those who listen to them."""
        dispatch, times = self._dispatch, self._times
        alone, send = self._only is not None, self._sender.send
        wall_minus_now_s = times.compare(self._now)
        last_s: float | None = None
        for can_id, data, stamp_s in frames:
            if self._stopped:
                return
            table, remote = dispatch.data, False
            if can_id > HIGHEST_ID:
                if not self._is_remote(can_id):
                    continue
                can_id &= HIGHEST_ID
                table, remote, data = dispatch.remote, True, b""
            received_s: float | None = stamp_s - wall_minus_now_s  # as `of`, without a call
            if not 0.0 <= self._now - stamp_s + wall_minus_now_s <= LONGEST_DELAY_S:  # or it is not a number
                received_s = times.of(stamp_s, self._now)
            last_s = -NEVER if received_s is None else received_s
            self._received += 1
            if self._bus_state.troubled:
                self._bus_state.reading_worked(self._now, frame=True)
            ports = table.get(can_id, dispatch.everyone)
            if not ports:
                continue
            frame = _new(Frame, (can_id, data, remote, received_s))
            for port in ports:
                try:
                    answers = port.device_receive(frame, self._now)
                except Exception as error:
                    raise DeviceFailure(port.device, error) from error
                if port.keeps_deadline:
                    dispatch.called(port)
                if answers:
                    if alone and not dispatch.moved:
                        for answer in answers:
                            send(port, answer)
                    else:
                        self._spread(port, answers)
            if dispatch.moved:
                dispatch.follow()
        if last_s is not None:
            self._came(last_s)

    def _is_remote(self, can_id: int) -> bool:
        """A CAN-ID with flags: a remote frame, or one that is not of CANopen."""
        if can_id & ERROR:
            self._error_frames += 1
            self._bus_state.error_frame(can_id & ~ERROR, self._now)
            return False
        return not can_id & EXTENDED  # others may share the bus

    def _came(self, received_s: float) -> None:
        """When the last frame was received; -NEVER if that is not known."""
        self._received_s = received_s
        if received_s == -NEVER:
            self._longest_drain_s = LONGEST_BLIND_DRAIN_S
            waited_for = self._now - self._asked_s >= LEAST_WAIT_S
        else:
            self._longest_drain_s = LONGEST_DRAIN_S
            waited_for = received_s >= self._asked_s
        if waited_for:
            self._put_off_s = None

    def _tick(self) -> None:
        self._now = now = self._clock()
        for port in self._dispatch.ports:
            deadline = port.due_s if port.keeps_deadline else port.device_deadline()
            if deadline is not None and deadline <= now:
                self._spread(port, self._asked(port, port.device.tick, now))

    def _notify_bus_state(self) -> None:
        """The bus has gone, or is back; not for one whose boot-up has not left."""
        self._now = now = self._clock()
        lost, returned = self._bus_state.lost(), self._bus_state.returned(now)
        starting = {port for port, _ in self._sender.owed.values()}
        for port in self._dispatch.ports:
            device = port.device
            if isinstance(device, BusWatching):
                if lost and port not in starting:
                    self._off.add(port)
                    self._spread(port, self._asked(port, device.bus_off, now))
                if returned and port in self._off:
                    self._off.remove(port)
                    self._spread(port, self._asked(port, device.bus_back, now))
        self._dispatch.accept_all(self._bus_state.gone)  # any frame is a sign of life

    def _compute(self) -> None:
        """Look for computations, at this rate only: they take seconds."""
        self._compute_s = self._asked_s + POLL_S
        for port, computation in self._computations:
            frames = self._asked(port, computation.poll, self._clock())
            if frames:
                self._spread(port, frames)
        self._meanwhile(self._asked_s)
        self._dispatch.ask_all()

    def _asked(self, port: Port, method: Callable[[float], list[Frame]], now: float) -> list[Frame]:
        """What a method of the device gives; DeviceFailure for what it raises."""
        try:
            frames = method(now)
        except Exception as error:
            raise DeviceFailure(port.device, error) from error
        if port.keeps_deadline:
            self._dispatch.called(port)
        return frames

    def _spread(self, sender: Port, frames: list[Frame]) -> None:
        """Send frames, also to the other devices of this process."""
        dispatch, send = self._dispatch, self._sender.send
        if dispatch.moved:
            dispatch.follow()  # before the master learns that it may send what is new
        if self._only is not None:
            for frame in frames:
                send(sender, frame)
            return
        queue: deque[tuple[Port, Frame]] = deque([(sender, frame) for frame in frames])
        while queue:
            origin, frame = queue.popleft()
            if dispatch.moved:
                dispatch.follow()
            send(origin, frame)
            for port in dispatch.listeners(frame):
                if port is not origin:
                    self._now = now = self._clock()
                    try:
                        answers = port.device_receive(frame, now)
                    except Exception as error:
                        raise DeviceFailure(port.device, error) from error
                    if port.keeps_deadline:
                        dispatch.called(port)
                    if answers:
                        queue.extend((port, answer) for answer in answers)


def _in_one_line(error: Exception) -> str:
    """What was raised, and where."""
    text = " ".join(str(error).split())
    last = error.__traceback__
    while last is not None and last.tb_next is not None:
        last = last.tb_next
    where = "" if last is None else f" ({Path(last.tb_frame.f_code.co_filename).name}:{last.tb_lineno})"
    return f"{type(error).__name__}{': ' if text else ''}{text}{where}"


@contextlib.contextmanager
def on_signals(call: Callable[[], None], numbers: Iterable[int]) -> Iterator[None]:
    """Call ``call`` on these signals."""

    def handle(number: int, frame: FrameType | None) -> None:
        call()

    before = {number: signal.signal(number, handle) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def ending_on_signals(stop: Callable[[], None]) -> contextlib.AbstractContextManager[None]:
    """Call ``stop`` on Ctrl-C, SIGTERM and SIGHUP, unless that is ignored (nohup)."""
    endings = [signal.SIGINT, signal.SIGTERM]
    hangup = getattr(signal, "SIGHUP", None)  # not on every system
    if hangup is not None and signal.getsignal(hangup) is not signal.SIG_IGN:
        endings.append(hangup)
    return on_signals(stop, endings)


@contextlib.contextmanager
def outside_collections() -> Iterator[None]:
    """What there is now is left out of garbage collections, until the end: 5 µs in place of 40 ms."""
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
