"""The bus of a runner, its implementation on python-can, and reception that survives failures.

A device must not receive its own frames: interfaces mark them (``is_rx`` is false); udp_multicast returns the
channel name of a message, so a unique name marks them.
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import time
from collections.abc import Callable, Iterable
from typing import Protocol
from uuid import uuid4

import can
from can.interfaces.socketcan import SocketcanBus
from can.interfaces.udp_multicast import UdpMulticastBus

from canfb.bus.bus_state import BUS_FAILS, BUS_WORKS, RETRY_S, FailureWatch, code_of, is_down
from canfb.bus.shared_bus import SharedBus
from canfb.cia301.frame import HIGHEST_ID
from canfb.errors import BusError, reason

MULTICAST = "udp_multicast"  # its name in python-can

# Flags in the CAN-ID of a struct can_frame (linux/can.h).
EXTENDED = 0x8000_0000
REMOTE = 0x4000_0000
ERROR = 0x2000_0000


def flagged_id(message: can.Message) -> int:
    """The CAN-ID, with the flag ERROR, or EXTENDED for a frame that is not CANopen."""
    if message.is_error_frame:
        return message.arbitration_id | ERROR
    return message.arbitration_id | (EXTENDED if message.is_extended_id or message.is_fd else 0)


# A frame: CAN-ID with these flags, data, and receive time on the wall clock, seconds. The time is 0.0, or of
# any other clock, if the bus has no such time. A frame with EXTENDED is not CANopen.
Received = tuple[int, bytes, float]


class FrameBus(contextlib.AbstractContextManager["FrameBus"], Protocol):
    """An open bus that transfers frames; the context manager closes it. CanError or OSError."""

    def receive(self, wait_s: float) -> Received | None:
        """The next frame; None if there is none within ``wait_s``."""

    def send(self, can_id: int, data: bytes, remote: bool) -> bool:
        """False if the bus does not accept a frame now."""

    def accept(self, can_ids: Iterable[int] | None, remote_can_ids: Iterable[int]) -> None:
        """Receive only these CAN-IDs, None: all."""


AF_CAN = getattr(socket, "AF_CAN", None)  # on Linux only

# Size of the receive queue: 2700 frames, because the kernel counts 768 bytes per frame and doubles the size
# requested. The default is 277 frames, 30 ms of a full bus at 1 Mbit/s. Without CAP_NET_ADMIN the kernel
# grants at most net.core.rmem_max, by default 554 frames.
QUEUE_BYTES = 1 << 20
_SO_RCVBUFFORCE = 33  # asm-generic/socket.h


def enlarge_queue(one: socket.socket) -> None:
    """Enlarge the receive queue, for frames that wait while this process is busy."""
    for option in (_SO_RCVBUFFORCE, socket.SO_RCVBUF):
        with contextlib.suppress(OSError):
            one.setsockopt(socket.SOL_SOCKET, option, QUEUE_BYTES)
            return


def enlarge_queue_of(bus: can.BusABC) -> None:
    """The same for a bus of python-can that is a socket."""
    with (
        contextlib.suppress(OSError, NotImplementedError, ValueError),
        socket.socket(fileno=os.dup(bus.fileno())) as one,
    ):
        enlarge_queue(one)


class NamedInterface:
    """The SocketCAN interface of a bus; after removal and re-creation it must be bound again."""

    def __init__(self, bus: can.BusABC) -> None:
        under = bus.under if isinstance(bus, SharedBus) else bus
        self._bus = None
        if isinstance(under, SocketcanBus) and under.channel and under.socket.family == AF_CAN:
            self._bus = under

    def comes_back(self, error: Exception) -> bool:
        return code_of(error) == errno.ENETDOWN or (self._bus is not None and is_down(error))

    def bind(self) -> None:
        bus = self._bus
        if bus is not None and bus.socket.getsockname()[0] != bus.channel:
            bus.socket.bind((bus.channel,))
            bus.set_filters(bus.filters)  # the kernel lost them with the interface


class Reception:
    """Receives from ``bus``, and survives an interface that is down or gone; BusError for other failures.

    ``report`` gets a line when the bus fails and works again. ``lasts``: no failure ends the reception.
    """

    def __init__(
        self,
        bus: can.BusABC,
        report: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
        *,
        lasts: bool = False,
    ) -> None:
        self._bus, self._clock, self._sleep, self._lasts = bus, clock, sleep, lasts
        self._interface = NamedInterface(bus)
        self._watch = FailureWatch(report, BUS_FAILS, BUS_WORKS)

    def receive(self, wait_s: float) -> can.Message | None:
        try:
            message = self._bus.recv(wait_s)
            if message is None:
                self._interface.bind()
        except (can.CanError, OSError) as error:
            if not self._lasts and not self._interface.comes_back(error):
                raise BusError(f"{BUS_FAILS}: {reason(error)}") from error
            if self._watch.failed(error, self._clock()):
                self._sleep(RETRY_S)
            return None
        if message is not None and self._watch.failed_s is not None:
            self._watch.worked(self._clock())
        return message


# Buses of python-can that return frames sent through them, marked by `is_rx` false. SocketCAN and Kvaser also
# mark frames of other processes on the same computer so, which must be received.
_ECHOING = frozenset({"GsUsbBus", "CantactBus", "VirtualBus"})
_IGNORED: Received = EXTENDED, b"", 0.0


class PythonCanBus(contextlib.AbstractContextManager["PythonCanBus"]):
    """A :class:`.FrameBus` on python-can, without its own frames."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._interface = NamedInterface(bus)
        # Such a bus transfers the channel name of a message: a unique name marks its own frames.
        self._mark = uuid4().hex if brings_own_frames_back(bus) else None
        self._echoes = type(bus).__name__ in _ECHOING

    def receive(self, wait_s: float) -> Received | None:
        message = self._bus.recv(wait_s)
        if message is None:
            self._interface.bind()
            return None
        if (self._echoes and not message.is_rx) or (self._mark and message.channel == self._mark):
            return _IGNORED
        can_id = flagged_id(message)
        if message.is_remote_frame and can_id <= HIGHEST_ID:
            can_id |= REMOTE
        return can_id, bytes(message.data), message.timestamp

    def send(self, can_id: int, data: bytes, remote: bool) -> bool:
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

    def accept(self, can_ids: Iterable[int] | None, remote_can_ids: Iterable[int]) -> None:
        """Without effect, all frames are received: filters differ between interfaces."""

    def __exit__(self, *raised: object) -> None:
        self._bus.shutdown()


def brings_own_frames_back(bus: can.BusABC) -> bool:
    """True for udp_multicast."""
    return isinstance(bus, UdpMulticastBus)
