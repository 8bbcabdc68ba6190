"""Any bus of python-can as frames."""

from __future__ import annotations

from collections.abc import Iterable
from types import TracebackType
from typing import Self
from uuid import uuid4

import can
from can.interfaces.udp_multicast import UdpMulticastBus

from canfb.bus.frame_bus import ERROR, EXTENDED, REMOTE, Received
from canfb.bus.reception import NamedInterface

# Buses of python-can that hand out what was sent through them, and say so (`is_rx` is false). SocketCAN and
# Kvaser say it of frames of other processes on the same computer, which are to be heard.
_ECHOING = frozenset({"GsUsbBus", "CantactBus", "VirtualBus"})


class PythonCanBus:
    """A :class:`.FrameBus` on python-can. It leaves out CAN FD, and its own frames if they come back."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._interface = NamedInterface(bus)
        # Such a bus carries the channel of a message along: it shows which frames are ours.
        self._mark = uuid4().hex if brings_own_frames_back(bus) else None
        self._echoes = marks_own_frames(bus)

    def receive(self, wait_s: float) -> list[Received] | None:
        """One frame, or none of CANopen's; see :class:`.FrameBus`.

        A SocketCAN interface that was removed and made again is opened again.
        """
        message = self._bus.recv(wait_s)
        if message is None:
            self._interface.bind()
            return None
        if message.is_fd or (self._echoes and not message.is_rx):
            return []
        if self._mark is not None and message.channel == self._mark:
            return []
        can_id = message.arbitration_id
        if message.is_error_frame:
            can_id |= ERROR
        elif message.is_extended_id:
            can_id |= EXTENDED
        elif message.is_remote_frame:
            can_id |= REMOTE
        return [(can_id, bytes(message.data), message.timestamp)]

    def send(self, can_id: int, data: bytes, remote: bool) -> bool:
        """See :class:`.FrameBus`; a bus that takes none raises."""
        self._bus.send(
            can.Message(
                arbitration_id=can_id,
                data=data,
                is_remote_frame=remote,
                is_extended_id=False,
                channel=self._mark,
            )
        )
        return True

    def hear(self, can_ids: Iterable[int] | None, remote_can_ids: Iterable[int]) -> None:
        """All frames are heard: a filter is another thing on each interface."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bus.shutdown()


def marks_own_frames(bus: can.BusABC) -> bool:
    """True where a message with ``is_rx`` false was sent through this very bus: gs_usb and the like."""
    return type(bus).__name__ in _ECHOING


def brings_own_frames_back(bus: can.BusABC) -> bool:
    """True for udp_multicast, whose sender hears itself; a CAN controller does not."""
    return isinstance(bus, UdpMulticastBus)
