"""A reader for the frames of a bus or of a log."""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import can

from canfb.bus.clocks import ReceiveTimes
from canfb.bus.frame_bus import Reception, flagged_id
from canfb.cia301.frame import HIGHEST_ID, Frame
from canfb.logfile.bus_logs import BusLogFile
from canfb.logfile.log_files import LogError
from canfb.monitoring.bus_model import BusModel
from canfb.monitoring.layout import ModuleReading, Recognition, assumed_objects
from canfb.monitoring.snapshot import BusSnapshot
from canfb.view.module_view import Read

log = logging.getLogger(__name__)

LONGEST_WAIT_S = 0.1  # longest delay until a signal is noticed
LEAST_WAIT_S = 1e-3  # tolerance of the time of a snapshot: avoids busy waiting because of rounding
RECOGNISED_IN = 10_000  # frames at the beginning of a log in which modules are recognised
LONGEST_GAP_S = 10.0  # a longer pause in a log is skipped

Show = Callable[[BusSnapshot], None]


class MessageReader:
    """Reads frames of any kind until :attr:`stopped` is set, or for ``seconds``.

    A line is logged when an interface fails or returns (:class:`.Reception`). ``clock``, ``wall`` and
    ``sleep``: for tests.
    """

    def __init__(
        self,
        seconds: float | None = None,
        clock: Callable[[], float] = time.monotonic,
        wall: Callable[[], float] = time.time,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._seconds, self.clock, self._wall, self.sleep = seconds, clock, wall, sleep
        self.stopped = threading.Event()

    def bus(
        self, bus: can.BusABC, due: Callable[[], float] = lambda: float("inf")
    ) -> Iterator[tuple[float, Frame | None]]:
        """Seconds since the beginning and each frame; None: no frame, or ``due``. BusError."""
        times = ReceiveTimes(self.clock, self._wall)
        reception = Reception(bus, log.warning, self.clock, self.sleep)
        began = now = self.clock()
        while not self.stopped.is_set() and (self._seconds is None or now - began < self._seconds):
            message = reception.receive(min(LONGEST_WAIT_S, max(LEAST_WAIT_S, due() - (now - began))))
            now = self.clock()
            if message is None:
                times.emptied()
                yield now - began, None
            else:
                received = times.received(message.timestamp, now)
                at = (now if received is None else received) - began
                yield at, Frame(flagged_id(message), bytes(message.data), message.is_remote_frame, at)

    def log(self, path: Path) -> Iterator[tuple[float, Frame]]:
        """Seconds since the first frame and each frame; CanfbError for an unreadable or empty file."""
        began: float | None = None
        stamp = 0.0
        log_file = BusLogFile(path, others=True)
        for frame in log_file:
            given = frame.timestamp or stamp
            stamp = given if given + LEAST_WAIT_S > given else stamp  # NaN or out of range: the last
            began = stamp if began is None else began
            if self.stopped.is_set() or (self._seconds is not None and stamp - began > self._seconds):
                return
            yield stamp - began, frame
        if began is None:
            raise log_file.no_frame()
        log_file.check_end(log.warning)


def classic(frames: Iterable[tuple[float, Frame | None]]) -> Iterator[tuple[float, Frame]]:
    first_s: float | None = None
    for time_s, frame in frames:
        if frame is not None and frame.can_id <= HIGHEST_ID:
            first_s = time_s if first_s is None else first_s
            yield time_s - first_s, frame


def recognised(log: Path) -> dict[int, Read]:
    recognition, frames = Recognition(), itertools.islice(BusLogFile(log), RECOGNISED_IN)
    found = {recognition.found(frame.can_id, frame.data) for frame in frames}
    return {node: assumed_objects(node) for node in found if node is not None}


class Watching:
    """Feeds ``model``; ``show`` gets a snapshot ``rate_hz`` times a second.

    :meth:`put` accepts SDO readings from any thread.
    """

    def __init__(
        self, model: BusModel, show: Show, rate_hz: float, reader: MessageReader | None = None
    ) -> None:
        self._model, self._show, self._interval_s = model, show, 1.0 / rate_hz
        self._reader = reader or MessageReader()
        self._readings: deque[ModuleReading] = deque()
        self.latest: BusSnapshot | None = None
        self.stop = self._reader.stopped.set

    def put(self, reading: ModuleReading) -> None:
        self._readings.append(reading)

    def opened(self, bus: can.BusABC) -> None:
        self._due_s = self._interval_s
        for at, frame in self._reader.bus(bus, lambda: self._due_s):
            if frame is not None:
                self._model.receive(frame, at)
            if at >= self._due_s:
                self._look(at)
                self._due_s = max(self._due_s + self._interval_s, at)

    def log(self, path: Path, speed: float | None = None) -> None:
        """Feed from a log in its time, ``speed`` times as fast; None: as fast as possible."""
        now, due = 0.0, self._interval_s
        try:
            for now, frame in self._reader.log(path):
                if not abs(now - due) < LONGEST_GAP_S:
                    due = now + self._interval_s
                while now >= due and not self._reader.stopped.is_set():
                    left_s = self._interval_s / speed if speed is not None else 0.0
                    while left_s > 0.0 and not self._reader.stopped.is_set():
                        self._reader.sleep(min(left_s, LONGEST_WAIT_S))
                        left_s -= LONGEST_WAIT_S
                    self._look(due)
                    due += self._interval_s
                self._model.receive(frame, now)
        except LogError:  # truncated: show what was readable
            if now > 0.0:
                self._look(now)
            raise
        self._look(now)

    def _look(self, now: float) -> None:
        while self._readings:
            reading = self._readings.popleft()
            module = self._model.learn(reading.layout)
            for place, value in reading.values.items():
                module.put(place, value, now)
        self.latest = self._model.snapshot(now)
        self._show(self.latest)
