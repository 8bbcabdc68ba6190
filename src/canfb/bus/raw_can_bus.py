"""SocketCAN by a raw socket: receive times of kernel or controller, filters in the kernel.

All filters are replaced in one call, so that no frame is lost; error frames always pass.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import select
import socket
import struct
from collections.abc import Iterable
from typing import Self

from canfb.bus.bus_state import ERROR_RESTARTED, INTERFACE_DOWN
from canfb.bus.clocks import OtherClock
from canfb.bus.frame_bus import ERROR, EXTENDED, REMOTE, Received, enlarge_queue

# Socket options of Linux that the module `socket` lacks (asm-generic/socket.h), and flags of the second
# (linux/net_tstamp.h): hardware receive times if the driver has them, as `candump -H` shows.
_SO_TIMESTAMPNS = 35
_SO_TIMESTAMPING = 37
_RX_HARDWARE, _RAW_HARDWARE = 1 << 2, 1 << 6

# Control messages of these options: one timespec of the kernel; three of the hardware, of which the last is
# used.
_KERNEL = struct.Struct("@ll")
_HARDWARE = struct.Struct("@6l")
_CONTROL_BYTES = socket.CMSG_SPACE(_KERNEL.size) + socket.CMSG_SPACE(_HARDWARE.size)
LONGEST_LATENCY_S = 0.01  # from controller to kernel; if longer, the clock of the controller was set


class FrameReader:
    """Reads struct can_frame, with receive times, from a datagram socket, without waiting."""

    def __init__(self, source: socket.socket) -> None:
        source.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        with contextlib.suppress(OSError):  # without hardware times, kernel times suffice
            source.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPING, _RX_HARDWARE | _RAW_HARDWARE)
        self._receive = source.recvmsg
        self._controller = OtherClock(LONGEST_LATENCY_S)

    def read(self) -> Received | None:
        try:
            frame, controls, _, _ = self._receive(_FRAME.size, _CONTROL_BYTES, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return None
        can_id, length, data = _FRAME.unpack(frame)
        stamp_s = 0.0
        for _, kind, times in controls:
            if kind == _SO_TIMESTAMPNS:
                seconds, nanoseconds = _KERNEL.unpack(times)
                stamp_s = seconds + nanoseconds * 1e-9
            elif kind == _SO_TIMESTAMPING:
                *_, seconds, nanoseconds = _HARDWARE.unpack(times)
                received_s = self._controller.received(seconds + nanoseconds * 1e-9, stamp_s)
                stamp_s = stamp_s if received_s is None else received_s
        return can_id, data[:length], stamp_s


_FRAME = struct.Struct("=IB3x8s")  # struct can_frame (linux/can.h)
_FILTER = struct.Struct("=II")  # struct can_filter: CAN-ID and mask
_STANDARD_ID = 0x7FF
_EXACT = EXTENDED | REMOTE | _STANDARD_ID  # with this mask the kernel uses a look-up table, not a list
RESOLUTION_S = 0.001  # resolution of poll
MOST_FILTERS = 512  # CAN_RAW_FILTER_MAX
_IFREQ = struct.Struct("16sh22x")  # struct ifreq (linux/if.h) with its flags
_SIOCGIFFLAGS = 0x8913
_IFF_UP = 1
_ANY_STANDARD = _FILTER.pack(0, EXTENDED)
_ALL_ERRORS = 0x1FFF_FFFF
_CAN_RAW_ERR_FILTER = 2  # python names it on Linux only


class RawCanBus(contextlib.AbstractContextManager["RawCanBus"]):
    """A :class:`.FrameBus` on a SocketCAN interface; sending never waits.

    While the interface is down or gone each :meth:`receive` raises; the first frame after that is an
    error frame "restarted".
    """

    def __init__(self, raw: socket.socket, channel: str = "") -> None:
        """``raw``: a bound raw CAN socket, or another one that transfers struct can_frame."""
        self._channel = channel
        self._down = False
        raw.setblocking(False)
        self._socket = raw
        self._send = raw.send
        self._is_can = raw.family == getattr(socket, "AF_CAN", None)
        self._read = FrameReader(raw).read
        self._sources = [raw]
        poll = select.poll()
        poll.register(raw, select.POLLIN)
        self._poll = poll.poll
        self._full: list[socket.socket] = []  # the socket, while its send queue is full
        self._filters = b""  # filters set in the kernel
        self._chosen = _ANY_STANDARD
        if self._is_can:
            raw.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, _ALL_ERRORS)
            enlarge_queue(raw)

    @classmethod
    def open(cls, channel: str) -> Self:
        """OSError if the interface does not exist or SocketCAN is missing."""
        with contextlib.ExitStack() as opened:
            raw = opened.enter_context(socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW))
            bus = cls(raw, channel)  # enables times and error frames before the first frame
            raw.bind((channel,))
            opened.pop_all()
        return bus

    def receive(self, wait_s: float) -> Received | None:
        if self._down:
            return self._came_up()
        if wait_s == 0.0:
            ready: object = True  # try: reading never waits
        elif self._full or wait_s < RESOLUTION_S:
            ready = select.select(self._sources, self._full, [], wait_s)[0]
        else:
            ready = self._poll(int(wait_s * 1000.0))  # cheaper than select, but in milliseconds
        try:
            return self._read() if ready else None
        except OSError as error:
            self._note(error)
            raise

    def send(self, can_id: int, data: bytes, remote: bool) -> bool:
        try:
            self._send(_FRAME.pack(can_id | REMOTE if remote else can_id, len(data), data))
        except BlockingIOError:
            self._full = self._sources
            return False
        except OSError as error:
            if error.errno != errno.ENOBUFS:
                self._note(error)
                raise
            return False  # the queue of the interface is full; nothing reports when it has room
        if self._full:
            self._full = []
        return True

    def accept(self, can_ids: Iterable[int] | None, remote_can_ids: Iterable[int]) -> None:
        if not self._is_can:
            return
        filters = _ANY_STANDARD
        if can_ids is not None:
            accepted = [*sorted(can_ids), *(can_id | REMOTE for can_id in sorted(remote_can_ids))]
            if len(accepted) <= MOST_FILTERS:
                filters = b"".join(_FILTER.pack(can_id, _EXACT) for can_id in accepted)
        self._chosen = filters
        if filters != self._filters:
            with contextlib.suppress(OSError):  # the interface is gone; reading reports that
                self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, filters)
                self._filters = filters

    def _note(self, error: OSError) -> None:
        self._down = bool(self._channel) and error.errno in INTERFACE_DOWN

    def _came_up(self) -> Received:
        """An error frame "restarted" once the interface is up; OSError until then."""
        raw = self._socket
        if raw.getsockname()[0] != self._channel:  # the kernel unbound it when the interface was removed
            raw.bind((self._channel,))
            raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, self._chosen)
            self._filters = self._chosen
        raw.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)  # clear the old error, or reading would raise it
        request = _IFREQ.pack(self._channel.encode(), 0)
        if not _IFREQ.unpack(fcntl.ioctl(raw, _SIOCGIFFLAGS, request))[1] & _IFF_UP:
            raise OSError(errno.ENETDOWN, os.strerror(errno.ENETDOWN))
        self._down = False
        return ERROR | ERROR_RESTARTED, b"", 0.0

    def __exit__(self, *raised: object) -> None:
        self._socket.close()
