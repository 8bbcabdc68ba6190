"""The frames of a bus, or of a log, one by one with their times: for ``canfb dump``."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import can

from canfb.bus.frame_bus import Reception
from canfb.cia301.frame import Frame
from canfb.monitoring.watching import messages_of

log = logging.getLogger(__name__)

LONGEST_WAIT_S = 0.1  # how late a signal may be noticed

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
