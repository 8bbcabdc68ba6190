"""Frames of a bus as it goes on, or of a log: for the model of a monitor, or one by one (``canfb dump``)."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import can

from canfb.bus.clocks import ReceiveTimes
from canfb.bus.frame_bus import Reception
from canfb.bus.opening import open_bus
from canfb.cia301.frame import Frame
from canfb.errors import CanfbError, reason
from canfb.monitoring.bus_model import BusModel
from canfb.monitoring.layout import Origin, layout_of
from canfb.monitoring.sdo_reading import SdoReading
from canfb.monitoring.snapshot import BusSnapshot

log = logging.getLogger(__name__)

LONGEST_WAIT_S = 0.1  # how late a signal may be noticed
READING_WAIT_S = 0.01  # with SDO requests to send
LONGEST_GAP_S = 10.0  # in a log: a longer pause is passed over

Show = Callable[[BusSnapshot], None]


class Watching:
    """Feeds ``model`` and calls ``show`` with a snapshot ``rate_hz`` times a second, until :meth:`stop`.

    Only listens, but for what ``readings`` ask by SDO. An interface that is down or gone is waited for:
    ``report`` gets a line when it goes, and one when it is back (:class:`.Reception`). ``clock``, ``wall``
    and ``sleep`` are those of the system, but for tests.
    """

    def __init__(
        self,
        model: BusModel,
        show: Show,
        rate_hz: float,
        readings: Sequence[SdoReading] = (),
        clock: Callable[[], float] = time.monotonic,
        wall: Callable[[], float] = time.time,
        sleep: Callable[[float], None] = time.sleep,
        report: Callable[[str], None] = log.warning,
    ) -> None:
        self._model, self._show, self._interval_s = model, show, 1.0 / rate_hz
        self._readings = list(readings)
        self._clock, self._wall, self._sleep = clock, wall, sleep
        self._report = report
        self._stopped = False

    def stop(self) -> None:
        """End it; may be called from a signal handler."""
        self._stopped = True

    def bus(self, options: dict[str, object], seconds: float | None = None) -> None:
        """From a bus of python-can, with its own words. BusError, in one line, when it fails."""
        with open_bus(options) as bus:
            self.opened(bus, seconds)

    def opened(self, bus: can.BusABC, seconds: float | None = None) -> None:
        """From a bus that is open, for so many seconds."""
        times = ReceiveTimes(self._clock, self._wall)
        reception = Reception(bus, self._report, self._clock, self._sleep)
        began = now = self._clock()
        due = began + self._interval_s
        while not self._stopped and (seconds is None or now - began < seconds):
            wait = min(READING_WAIT_S if self._readings else LONGEST_WAIT_S, max(0.0, due - now))
            message = reception.receive(wait)
            now = self._clock()
            if message is None:
                times.emptied()
            else:
                received = times.received(message.timestamp, now)
                self._take(message, (now if received is None else received) - began)
            try:
                self._ask(bus, now - began)
            except (can.CanError, OSError) as error:
                reception.failed(error)
                now = self._clock()
            if now >= due:
                self._show(self._model.snapshot(now - began))
                due = max(due + self._interval_s, now)

    def log(self, path: Path, speed: float | None = None, seconds: float | None = None) -> None:
        """From a log that python-can reads, in its own time; the last snapshot is that of its end.

        ``speed``: so many times as fast as it was; None: as fast as it can be read. ``seconds`` of the log.
        CanfbError, in one line, for a file that cannot be read.
        """
        began: float | None = None
        now, due = 0.0, self._interval_s
        for message in messages_of(path):
            began = message.timestamp if began is None else began
            now = message.timestamp - began
            if self._stopped or (seconds is not None and now > seconds):
                break
            if not abs(now - due) < LONGEST_GAP_S:
                due = now + self._interval_s
            while now >= due and not self._stopped:
                if speed is not None:
                    self._sleep(self._interval_s / speed)
                self._show(self._model.snapshot(due))
                due += self._interval_s
            self._take(message, now)
        if began is None:
            raise CanfbError(f"{path}: there is no frame in it")
        self._show(self._model.snapshot())

    def _take(self, message: can.Message, at: float) -> None:
        if message.is_error_frame:
            self._model.error_frame()
        elif message.is_extended_id or message.is_fd:
            self._model.other_frame(len(message.data), at)
        else:
            frame = Frame(message.arbitration_id, bytes(message.data), message.is_remote_frame, at)
            self._model.receive(frame, at)
            for reading in self._readings:
                self._read(reading, frame, at)

    def _read(self, reading: SdoReading, frame: Frame, at: float) -> None:
        was_complete = reading.complete
        for place, value in reading.receive(frame).items():
            self._model.put(reading.node_id, place, value, at)
        if reading.complete and not was_complete:
            self._model.learn(layout_of(reading.node_id, reading.settings.get, Origin.MODULE))

    def _ask(self, bus: can.BusABC, now: float) -> None:
        for reading in self._readings:
            request = reading.next(now)
            if request is not None:
                bus.send(can.Message(arbitration_id=request.can_id, data=request.data, is_extended_id=False))


def messages_of(path: Path) -> Iterable[can.Message]:
    """What is in a log. What its reader raises has no common root."""
    try:
        with can.LogReader(path) as reader:
            yield from reader
    except OSError as error:
        raise CanfbError(f"{path}: {error.strerror or error}") from error
    except Exception as error:
        raise CanfbError(f"{path}: cannot be read as a bus log: {reason(error)}") from error


TimedFrame = tuple[float, Frame]
"""A frame, and seconds since the first one."""


class Dumping:
    """Gives frames until :meth:`stop`, for ``seconds``; None: without end. CanfbError for what fails."""

    def __init__(
        self,
        seconds: float | None = None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._seconds, self._clock, self._sleep = seconds, clock, sleep
        self._stopped = False

    def stop(self) -> None:
        """End it; may be called from a signal handler."""
        self._stopped = True

    def bus(self, bus: can.BusABC) -> Iterator[TimedFrame]:
        """The frames of an open bus as they come; see :class:`.Reception` for one that fails."""
        reception = Reception(bus, log.warning, self._clock, self._sleep)
        began, first_s = self._clock(), None
        while not self._stopped and (self._seconds is None or self._clock() - began < self._seconds):
            message = reception.receive(LONGEST_WAIT_S)
            if message is None or not _is_classic(message):
                continue
            first_s = message.timestamp if first_s is None else first_s
            yield message.timestamp - first_s, _frame(message)

    def log(self, path: Path) -> Iterator[TimedFrame]:
        """The frames of a log that python-can reads, as fast as it can be read."""
        first_s = None
        for message in messages_of(path):
            first_s = message.timestamp if first_s is None else first_s
            passed_s = message.timestamp - first_s
            if self._stopped or (self._seconds is not None and passed_s > self._seconds):
                return
            if _is_classic(message):
                yield passed_s, _frame(message)


def _is_classic(message: can.Message) -> bool:
    return not (message.is_error_frame or message.is_extended_id or message.is_fd)


def _frame(message: can.Message) -> Frame:
    return Frame(message.arbitration_id, bytes(message.data), message.is_remote_frame)
