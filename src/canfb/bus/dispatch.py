"""Distribution of frames to devices, their deadlines, and sending."""

from __future__ import annotations

import errno
import os
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial

import can

from canfb.bus.bus_state import BusState
from canfb.bus.frame_bus import FrameBus
from canfb.cia301.cob import BOOT_UP, ERROR_CONTROL, NODE_ID
from canfb.cia301.frame import Frame
from canfb.device.core import NEVER, CanIds
from canfb.device.node import Device, Inhibited, Selective

Ports = tuple["Port", ...]


class Port:
    """A device as the runner calls it."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.inhibited: Mapping[int | None, object] = (
            device.inhibited if isinstance(device, Inhibited) else {}
        )
        self.sent: Callable[[int, float], None] = getattr(device, "sent", lambda can_id, now: None)
        self.due_s = NEVER
        self.can_ids = CanIds(frozenset(), frozenset())  # empty until read, and for a device that gets all
        self.moved = isinstance(device, Selective)


class Dispatch:
    """Devices by the CAN-IDs that they listen to, and by their deadlines.

    If the CAN-IDs of a device have ``moved``, :meth:`follow` updates the tables before the next frame.
    """

    def __init__(self, devices: list[Device], bus: FrameBus) -> None:
        self.ports = tuple(map(Port, devices))
        self.moved = True
        self.data: dict[int, Ports] = {}  # Receivers of data frames; other CAN-IDs go to ``everyone``.
        self.remote: dict[int, Ports] = {}
        self.everyone = tuple(port for port in self.ports if not port.moved)
        self._bus = bus
        self._accepts_all = False
        for port in self.ports:
            if isinstance(port.device, Selective):
                port.device.follow_can_ids(partial(self._has_moved, port))

    def due_s(self) -> float:
        return min([port.due_s for port in self.ports], default=NEVER)

    def called(self, port: Port) -> None:
        due_s = port.device.deadline()
        port.due_s = NEVER if due_s is None else due_s

    def listeners(self, frame: Frame) -> Ports:
        return (self.remote if frame.rtr else self.data).get(frame.can_id, self.everyone)

    def follow(self) -> None:
        self.moved = False
        for port in self.ports:
            if port.moved and isinstance(port.device, Selective):
                port.moved = False
                port.can_ids = port.device.can_ids()
        self.data = self._table(lambda port: port.can_ids.data)
        self.remote = self._table(lambda port: port.can_ids.remote)
        self._set_filters()

    def accept_all(self, enabled: bool) -> None:
        if enabled is not self._accepts_all:
            self._accepts_all = enabled
            self._set_filters()

    def _set_filters(self) -> None:
        if self._accepts_all or self.everyone:
            self._bus.accept(None, ())
        else:
            self._bus.accept(self.data, self.remote)

    def _table(self, can_ids: Callable[[Port], Iterable[int]]) -> dict[int, Ports]:
        return {
            can_id: tuple(one for one in self.ports if one in self.everyone or can_id in can_ids(one))
            for can_id in {can_id for port in self.ports for can_id in can_ids(port)}
        }

    def _has_moved(self, port: Port) -> None:
        port.moved = self.moved = True


RETRY_S = 0.0005  # a frame takes 0.05 to 0.13 ms at 1 Mbit/s
LONGEST_QUEUE = 256  # frames
LONGEST_DELAY_S = 0.1  # an older position is useless


@dataclass
class BusCounters:
    """Frames and failures of the bus."""

    received: int = 0
    sent: int = 0
    send_failures: int = 0
    error_frames: int = 0
    bus_failures: int = 0


class FrameSender:
    """Sends the frames of devices, and notifies those with inhibit times.

    Frames that the bus does not accept now wait: at most LONGEST_QUEUE frames, for LONGEST_DELAY_S. A boot-up
    that failed is sent before others.
    """

    def __init__(
        self, bus: FrameBus, clock: Callable[[], float], bus_state: BusState, counters: BusCounters
    ) -> None:
        self._bus_send = bus.send
        self._clock = clock
        self._bus_state = bus_state
        self._counters = counters
        # Frames that the bus has not accepted yet, and since when they wait.
        self.waiting: deque[tuple[Port, Frame, float]] = deque()
        # Boot-ups that failed, by CAN-ID; :meth:`retry_owed` sends them again.
        self.owed: dict[int, tuple[Port, Frame]] = {}

    def send(self, port: Port, frame: Frame) -> None:
        if self.owed:
            self.retry_owed()
        if self.waiting or not self._try(port, frame):
            if len(self.waiting) < LONGEST_QUEUE:
                self.waiting.append((port, frame, self._clock()))
            else:
                self._failed(port, frame, _no_room())

    def _try(self, port: Port, frame: Frame) -> bool:
        can_id, data, remote, _ = frame
        try:
            if not self._bus_send(can_id, data, remote):
                return False
        except (can.CanError, OSError) as error:
            self._failed(port, frame, error)
        else:
            self._counters.sent += 1
            if self._bus_state.troubled or can_id in port.inhibited:
                self._left(port, can_id)
        return True

    def retry(self, now: float) -> None:
        while self.waiting:
            port, frame, since_s = self.waiting[0]
            if now - since_s > LONGEST_DELAY_S:
                self._failed(port, frame, _no_room())
            elif not self._try(port, frame):
                return
            self.waiting.popleft()

    def retry_owed(self) -> None:
        for can_id, (port, frame) in list(self.owed.items()):
            try:
                gone = not self.waiting and self._bus_send(can_id, frame.data, frame.rtr)
            except (can.CanError, OSError):
                return
            if not gone:
                return
            del self.owed[can_id]
            self._counters.sent += 1
            self._left(port, can_id)

    def _left(self, port: Port, can_id: int) -> None:
        if self._bus_state.troubled:
            self._bus_state.sending_worked(self._clock())
        if can_id in port.inhibited:
            port.sent(can_id, self._clock())

    def _failed(self, port: Port, frame: Frame, error: Exception) -> None:
        self._counters.send_failures += 1
        now = self._clock()
        self._bus_state.sending_failed(error, now)
        if frame.data == BOOT_UP and frame.can_id & ~NODE_ID == ERROR_CONTROL:
            self.owed[frame.can_id] = (port, frame)
        if frame.can_id in port.inhibited:  # the inhibit time starts now: the frame may have left after all
            port.sent(frame.can_id, now)


def _no_room() -> OSError:
    return OSError(errno.ENOBUFS, os.strerror(errno.ENOBUFS))
