"""Several frames of a socket with one system call, each with its receive time: recvmmsg(2) of Linux."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import socket
import struct

from canfb.bus.frame_bus import Received
from canfb.bus.hardware_times import HardwareTimes

MOST_FRAMES = 32  # of one call

# Socket options of Linux that the module socket does not name (asm-generic/socket.h), and the flags of the
# second (linux/net_tstamp.h): times of the hardware where a driver has them, as `candump -H` shows them.
_SO_TIMESTAMPNS = 35
_SO_TIMESTAMPING = 37
_RX_HARDWARE, _RAW_HARDWARE = 1 << 2, 1 << 6

# A slot of the buffer holds a struct can_frame and its control messages: always the time of the kernel
# (timespec), and that of the hardware if there is one (three of them, of which the last counts).
_SLOT = struct.Struct("@IB3x8s Nii ll N")
_HARDWARE_AT = _SLOT.size - struct.calcsize("@N")
_HARDWARE = struct.Struct("@Nii llll ll")
_FRAME_BYTES = 16
_SLOT_BYTES = (_HARDWARE_AT + _HARDWARE.size + 15) & ~15
_NO_HARDWARE_TIME = bytes(struct.calcsize("@N"))


class _IoVector(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


class _MessageHeader(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_void_p),
        ("name_length", ctypes.c_uint32),
        ("vectors", ctypes.c_void_p),
        ("vectors_length", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("control_length", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )


class _Message(ctypes.Structure):
    """struct mmsghdr."""

    _fields_ = (("header", _MessageHeader), ("received_bytes", ctypes.c_uint))


_MESSAGE_BYTES = ctypes.sizeof(_Message)


class FrameReader:
    """Reads struct can_frame from a datagram socket without waiting.

    It turns on the receive times of ``source``, which must stay open as long as this is used.
    AttributeError where there is no recvmmsg.
    """

    def __init__(self, source: socket.socket) -> None:
        self._receive_many = ctypes.CDLL(None, use_errno=True).recvmmsg
        source.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        with contextlib.suppress(OSError):  # the times of the kernel are enough
            source.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPING, _RX_HARDWARE | _RAW_HARDWARE)
        self._hardware_times = HardwareTimes()
        self._slots = bytearray(_SLOT_BYTES * MOST_FRAMES)
        base = ctypes.addressof(ctypes.c_char.from_buffer(self._slots))
        starts = [base + number * _SLOT_BYTES for number in range(MOST_FRAMES)]
        self._vectors = (_IoVector * MOST_FRAMES)(*(_IoVector(start, _FRAME_BYTES) for start in starts))
        messages = (_Message * MOST_FRAMES)()
        for message, start, vector in zip(messages, starts, self._vectors, strict=True):
            header = message.header
            header.vectors, header.vectors_length = ctypes.addressof(vector), 1
            header.control, header.control_length = start + _FRAME_BYTES, _SLOT_BYTES - _FRAME_BYTES
        self._messages = memoryview(messages).cast("B")
        self._untouched = bytes(messages)  # the call changes the lengths
        self._arguments = (
            ctypes.c_int(source.fileno()),
            ctypes.c_void_p(ctypes.addressof(messages)),
            ctypes.c_uint(MOST_FRAMES),
            ctypes.c_int(socket.MSG_DONTWAIT),
            None,
        )

    def read(self) -> list[Received] | None:
        """The frames that wait, at most MOST_FRAMES; None for none. OSError as recv raises it."""
        count = self._receive_many(*self._arguments)
        if count <= 0:
            code = ctypes.get_errno()
            if count == 0 or code in (errno.EAGAIN, errno.EINTR):
                return None
            raise OSError(code, os.strerror(code))
        frames: list[Received] = []
        slots, unpack = self._slots, _SLOT.unpack_from
        at = 0
        for _ in range(count):
            can_id, length, data, _, _, _, seconds, nanoseconds, hardware = unpack(slots, at)
            stamp_s = seconds + nanoseconds * 1e-9
            if hardware:
                stamp_s = self._of_the_hardware(at + _HARDWARE_AT, stamp_s)
            frames.append((can_id, data if length == 8 else data[:length], stamp_s))
            at += _SLOT_BYTES
        used = count * _MESSAGE_BYTES
        self._messages[:used] = self._untouched[:used]
        return frames

    def _of_the_hardware(self, at: int, stamp_s: float) -> float:
        """The time of the hardware, by the time of day; the place is cleared for the next frame."""
        *_, seconds, nanoseconds = _HARDWARE.unpack_from(self._slots, at)
        self._slots[at : at + len(_NO_HARDWARE_TIME)] = _NO_HARDWARE_TIME
        return self._hardware_times.received(seconds + nanoseconds * 1e-9, stamp_s)
