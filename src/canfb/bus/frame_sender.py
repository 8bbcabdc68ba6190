"""Sending: at once, or in order when the bus has room again."""

from __future__ import annotations

import errno
import os
from collections import deque
from collections.abc import Callable

import can

from canfb.bus.bus_state import BusState
from canfb.bus.dispatch import Port
from canfb.bus.frame_bus import FrameBus
from canfb.cia301.cob import ERROR_CONTROL
from canfb.cia301.frame import Frame

NODE_ID = 0x7F
RETRY_S = 0.0005  # a frame takes 0.05 to 0.13 ms at 1 Mbit/s
LONGEST_QUEUE = 256  # frames
BOOT_UP = b"\0"  # of ERROR_CONTROL: no NMT state of a heartbeat is 0
LONGEST_DELAY_S = 0.1  # a position that is older helps nobody


class FrameSender:
    """Sends the frames of devices, and notifies those with inhibit times when their frames have left.

    A bus that takes no frame now keeps it and those that follow in a queue, LONGEST_QUEUE of them for
    LONGEST_DELAY_S. A boot-up that failed is sent before any other frame: a master waits for it.
    """

    def __init__(self, bus: FrameBus, clock: Callable[[], float], bus_state: BusState) -> None:
        self._bus_send = bus.send
        self._clock = clock
        self._bus_state = bus_state
        self.sent = 0
        self.failures = 0
        self.waiting: deque[tuple[Port, Frame, float]] = deque()
        """Frames that the bus did not take yet, and since when."""
        self.owed: dict[int, tuple[Port, Frame]] = {}
        """Boot-ups that failed, by their CAN-ID: for :meth:`retry_owed`."""

    def send(self, port: Port, frame: Frame) -> None:
        """Send a frame of the device at ``port``, or queue it."""
        if self.owed:
            self.retry_owed()
        if self.waiting or not self._try(port, frame):
            if len(self.waiting) < LONGEST_QUEUE:
                self.waiting.append((port, frame, self._clock()))
            else:
                self._failed(port, frame, _no_room())

    def _try(self, port: Port, frame: Frame) -> bool:
        """Send it, now or never; False if the bus takes none now."""
        can_id, data, remote, _ = frame
        try:
            if not self._bus_send(can_id, data, remote):
                return False
        except (can.CanError, OSError) as error:
            self._failed(port, frame, error)
        else:
            self.sent += 1
            if self._bus_state.troubled or can_id in port.inhibited:
                self._left(port, can_id)
        return True

    def retry(self, now: float) -> None:
        """Send what waits, as far as the bus takes it."""
        while self.waiting:
            port, frame, since_s = self.waiting[0]
            if now - since_s > LONGEST_DELAY_S:
                self._failed(port, frame, _no_room())
            elif not self._try(port, frame):
                return
            self.waiting.popleft()

    def retry_owed(self) -> None:
        """Send the boot-ups that failed, if the bus takes them now."""
        for can_id, (port, frame) in list(self.owed.items()):
            try:
                gone = not self.waiting and self._bus_send(can_id, frame.data, frame.rtr)
            except (can.CanError, OSError):
                return
            if not gone:
                return
            del self.owed[can_id]
            self.sent += 1
            self._left(port, can_id)

    def _left(self, port: Port, can_id: int) -> None:
        if self._bus_state.troubled:
            self._bus_state.sending_worked(self._clock())
        if can_id in port.inhibited:
            port.sent(can_id, self._clock())

    def _failed(self, port: Port, frame: Frame, error: Exception) -> None:
        self.failures += 1
        now = self._clock()
        self._bus_state.sending_failed(error, now)
        if frame.data == BOOT_UP and frame.can_id & ~NODE_ID == ERROR_CONTROL:
            self.owed[frame.can_id] = (port, frame)
        if frame.can_id in port.inhibited:  # it counts from here: it may have left after all
            port.sent(frame.can_id, now)


def _no_room() -> OSError:
    return OSError(errno.ENOBUFS, os.strerror(errno.ENOBUFS))
