"""Runs devices on a bus: receives and sends frames, observes deadlines, ends cleanly on a signal.

A deadline D is served once no frame received before D can still wait: the last one was received at R >= D,
or the queue was empty at D or later. Frames postpone a deadline by at most 1 s (0.1 s without receive times),
so that a flood cannot stop heartbeats. If a device raises, the run ends for all: its state is unknown.
"""

from __future__ import annotations

import contextlib
import gc
import logging
import signal
import time
import traceback
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import Any

import can

from canfb.bus.bus_state import RETRY_S as BUS_RETRY_S, BusState
from canfb.bus.clocks import ReceiveTimes
from canfb.bus.computing import Computation
from canfb.bus.dispatch import RETRY_S, BusCounters, Dispatch, FrameSender, Port
from canfb.bus.frame_bus import ERROR, EXTENDED, FrameBus, Received
from canfb.cia301.frame import HIGHEST_ID, Frame
from canfb.device.core import NEVER
from canfb.device.node import BusWatching, Computing, Device, Ending
from canfb.errors import CanfbError

log = logging.getLogger(__name__)

POLL_S = 0.01  # interval at which computations are polled
LONGEST_WAIT_S = 0.1  # longest delay until a signal is noticed
BUS_RESOLUTION_S = 0.001  # a bus may end a longer wait early by this
CLOSE_S = 1e-6  # rounding: a queue that is empty this shortly before a deadline is empty at the deadline
LEAST_WAIT_S = 2e-4  # without receive times: a read that takes longer has waited, so the queue was empty
LONGEST_DRAIN_S = 1.0  # how long waiting frames may postpone a deadline
LONGEST_BLIND_DRAIN_S = 0.1  # the same without receive times: the frames may be later than the deadline

_new = tuple.__new__


class DeviceFailure(CanfbError):
    """A program error in ``device``."""

    def __init__(self, device: Any, error: Exception) -> None:
        self.device = device
        super().__init__(f"program error: {_in_one_line(error)}")


class Runner:
    """Runs devices on one bus in the calling thread until :meth:`stop`; they receive each other's frames.

    ``report`` gets a line when the state of the bus changes; ``meanwhile`` is called some hundred times a
    second. DeviceFailure if a device raises. ``busy_poll``: never wait.
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
        self._times = ReceiveTimes(clock, wall)
        self.counters = BusCounters()
        self._received_s: float | None = None  # receive time of the last frame; None: no frame waits after it
        self._empty_s = -NEVER  # last time at which the queue was known to be empty
        self._longest_drain_s = LONGEST_DRAIN_S
        self._put_off_s: float | None = None  # since when waiting frames have postponed a deadline
        self._asked_s = self._now = clock()  # time of the last request for a frame; last reading of the clock
        self._compute_s = -NEVER  # next time to poll computations
        self._stopped = False
        self._bus_state = BusState(report)
        self._sender = FrameSender(bus, clock, self._bus_state, self.counters)
        self._owed_s = -NEVER  # next time to retry boot-ups that failed
        self._off: set[Port] = set()  # ports whose devices were notified that the bus is gone
        self._computations = [
            (port, Computation(port.device, report))
            for port in self._dispatch.ports
            if isinstance(port.device, Computing)
        ]

    def stop(self) -> None:
        self._stopped = True

    def hears(self, can_ids: Collection[int], wait_s: float, asked: Iterable[Frame] = ()) -> int | None:
        """Before :meth:`run`: send ``asked``; the first of these CAN-IDs received, None after ``wait_s``."""
        end_s = self._clock() + wait_s
        try:
            for can_id, data, remote, _ in asked:
                self._bus.send(can_id, data, remote)
            while (now := self._clock()) < end_s:
                self._now = now
                received = self._bus.receive(end_s - now)
                if received is not None and received[0] in can_ids:
                    return received[0]
                if received is not None and received[0] & ERROR:
                    self._take(*received)  # updates the state of the bus
        except (can.CanError, OSError):
            pass  # run() gets the error again, and reports it
        return None

    def run(
        self, finished: Callable[[], bool] = lambda: False, ready: Callable[[], None] = lambda: None
    ) -> None:
        """Power on, call ``ready``, serve until :meth:`stop` or ``finished()``."""
        try:
            for port in self._dispatch.ports:
                self._ask(port, port.device.start, self._clock())
            ready()
            while not self._stopped and not finished():
                received = self._wait()
                if received is not None:
                    self._take(*received)
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

    def _wait(self) -> Received | None:
        if self._dispatch.moved:
            self._dispatch.follow()
        self._now = asked = self._clock()
        due = self._dispatch.due_s()
        if due <= asked:
            self._tick(self._taken_until(due))
            asked, due = self._now, self._dispatch.due_s()
        self._asked_s = asked
        wait = min(due - asked, self._longest_wait_s) if due > asked else 0.0
        if self._sender.waiting:
            wait = min(wait, RETRY_S)
        received = None
        try:
            received = self._bus.receive(wait)
        except (can.CanError, OSError) as error:
            self.counters.bus_failures += 1
            self._now = self._clock()
            if self._bus_state.reading_failed(error, self._now):
                self._sleep(BUS_RETRY_S)
        else:
            self._now = self._clock()
            if self._bus_state.troubled:
                self._bus_state.reading_worked(self._now, frame=False)
        if received is None:
            self._received_s = self._put_off_s = None
            self._empty_s = asked + (wait if wait < BUS_RESOLUTION_S else wait - BUS_RESOLUTION_S)
            self._times.emptied()
        if self._sender.waiting:
            self._sender.retry(self._now)
        return received

    def _taken_until(self, due: float) -> float:
        """The time before which no frame can still wait; now, if ``due`` was postponed for too long."""
        taken_s = self._empty_s + CLOSE_S if self._received_s is None else self._received_s
        if taken_s >= due:
            self._put_off_s = None
        elif self._put_off_s is None:
            self._put_off_s = self._now
        elif self._now - self._put_off_s >= self._longest_drain_s:
            return self._now
        return min(taken_s, self._now)

    def _take(self, can_id: int, data: bytes, stamp_s: float) -> None:
        remote = False
        if can_id > HIGHEST_ID:
            if can_id & ERROR:
                self.counters.error_frames += 1
                self._bus_state.error_frame(can_id & ~ERROR, self._now)
                return
            if can_id & EXTENDED:
                return  # frames of other protocols may share the bus
            can_id, data, remote = can_id & HIGHEST_ID, b"", True
        self.counters.received += 1
        received_s = self._times.received(stamp_s, self._now)
        if received_s is None:
            self._received_s, self._longest_drain_s = -NEVER, LONGEST_BLIND_DRAIN_S
            waited_for = self._now - self._asked_s >= LEAST_WAIT_S
        else:
            self._received_s, self._longest_drain_s = received_s, LONGEST_DRAIN_S
            waited_for = received_s >= self._asked_s
        if waited_for:
            self._put_off_s = None
        if self._bus_state.troubled:
            self._bus_state.reading_worked(self._now, frame=True)
        dispatch, frame = self._dispatch, _new(Frame, (can_id, data, remote, received_s))
        for port in (dispatch.remote if remote else dispatch.data).get(can_id, dispatch.everyone):
            self._ask(port, port.device.receive, frame, self._now)

    def _tick(self, until: float) -> None:
        self._now = now = self._clock()
        for port in self._dispatch.ports:
            if port.due_s <= until:
                self._ask(port, port.device.tick, now, until)

    def _notify_bus_state(self) -> None:
        """Notify the devices, except those whose boot-up is not sent yet."""
        self._now = now = self._clock()
        lost, returned = self._bus_state.lost(), self._bus_state.returned(now)
        starting = {port for port, _ in self._sender.owed.values()}
        for port in self._dispatch.ports:
            device = port.device
            if isinstance(device, BusWatching):
                if lost and port not in starting:
                    self._off.add(port)
                    self._ask(port, device.bus_off, now)
                if returned and port in self._off:
                    self._off.remove(port)
                    self._ask(port, device.bus_back, now)
        self._dispatch.accept_all(self._bus_state.gone)  # while it is gone, any frame shows that it is back

    def _compute(self) -> None:
        self._compute_s = self._asked_s + POLL_S
        for port, computation in self._computations:
            self._ask(port, computation.poll, self._clock())
        self._meanwhile(self._asked_s)
        for port in self._dispatch.ports:
            self._dispatch.called(port)  # the program may have called devices: read their deadlines

    def _ask(self, port: Port, method: Callable[..., list[Frame]], *arguments: Any) -> None:
        """Call a method of the device; send its frames, also to other devices that listen."""
        dispatch, send = self._dispatch, self._sender.send
        frames = self._called(port, method, *arguments)
        if dispatch.moved:
            dispatch.follow()  # before the answer tells the master that it may use new CAN-IDs
        if not frames:
            return
        queue = deque([(port, frames)])
        while queue:
            origin, frames = queue.popleft()
            for frame in frames:
                self._now = now = self._clock()  # read before sending, which may wake another process
                send(origin, frame)
                for other in dispatch.listeners(frame):
                    if other is not origin:
                        answers = self._called(other, other.device.receive, frame, now)
                        if answers:
                            queue.append((other, answers))
                if dispatch.moved:
                    dispatch.follow()

    def _called(self, port: Port, method: Callable[..., list[Frame]], *arguments: Any) -> list[Frame]:
        try:
            frames = method(*arguments)
        except Exception as error:
            raise DeviceFailure(port.device, error) from error
        self._dispatch.called(port)
        return frames


def _in_one_line(error: Exception) -> str:
    text = " ".join(str(error).split())
    where = [
        f" ({Path(last.filename).name}:{last.lineno})"
        for last in traceback.extract_tb(error.__traceback__)[-1:]
    ]
    return f"{type(error).__name__}{': ' if text else ''}{text}{''.join(where)}"


@contextlib.contextmanager
def on_signals(call: Callable[[], None], numbers: Iterable[int]) -> Iterator[None]:
    before = {number: signal.signal(number, lambda *signalled: call()) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def ending_on_signals(stop: Callable[[], None]) -> contextlib.AbstractContextManager[None]:
    """Call ``stop`` on Ctrl-C, SIGTERM and SIGHUP, the last unless ignored (nohup)."""
    endings = [signal.SIGINT, signal.SIGTERM]
    hangup = getattr(signal, "SIGHUP", None)  # Windows has none
    if hangup is not None and signal.getsignal(hangup) is not signal.SIG_IGN:
        endings.append(hangup)
    return on_signals(stop, endings)


@contextlib.contextmanager
def outside_collections() -> Iterator[None]:
    """Exclude present objects from garbage collections, which then take 5 µs instead of 40 ms."""
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
