"""What goes in and comes out of the device, and the time of the running call."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Self

HIGHEST_ID = 0x7FF
LONGEST_DATA = 8
NEVER = float("inf")
"""The deadline of a service that waits for nothing, seconds."""


class Frame(NamedTuple):
    """One CAN frame with an 11-bit identifier.

    `can_id` is 0 to 7FFh, `data` holds 0 to 8 bytes, `rtr` marks a remote frame. `timestamp` is the
    time of reception in seconds, on the clock of `now`, where the bus gives one. Nothing is checked
    here, as a bus may deliver anything: the device drops and counts what is malformed.
    :meth:`checked` makes the frames of a program.
    """

    can_id: int
    data: bytes
    rtr: bool = False
    timestamp: float | None = None

    @classmethod
    def checked(
        cls, can_id: int, data: bytes = b"", rtr: bool = False, timestamp: float | None = None
    ) -> Self:
        """A frame that is one: `can_id` 0 to 7FFh, `data` 0 to 8 bytes, `rtr` true or false,
        `timestamp` seconds or None. TypeError or ValueError otherwise."""
        if not isinstance(can_id, int) or isinstance(can_id, bool):
            raise TypeError(f"can_id must be a whole number, not {can_id!r}")
        if not 0 <= can_id <= HIGHEST_ID:
            raise ValueError(f"can_id must be 0 to 7FFh (11 bits), not {can_id:X}h")
        if not isinstance(data, (bytes, bytearray, memoryview)):
            raise TypeError(f"data must be bytes, not {type(data).__name__}")
        if len(data) > LONGEST_DATA:
            raise ValueError(f"data must be 0 to 8 bytes, not {len(data)}: CANopen has no CAN FD")
        if not isinstance(rtr, bool):
            raise TypeError(f"rtr must be true or false, not {rtr!r}")
        if timestamp is not None and not isinstance(timestamp, (int, float)):
            raise TypeError(f"timestamp must be seconds or None, not {timestamp!r}")
        return cls(can_id, bytes(data), rtr, timestamp)


STAMP_NOISE_S = 1e-3

Emit = Callable[[Frame], None]
"""How a service sends a frame."""


class Moment:
    """The `now` of the running call, and the time at which its frame was received, seconds.

    The hooks of an SDO write carry no time, yet a timer that such a write starts needs one. The
    node sets it at each call from its arguments; nothing here reads a clock.

    `received` is the time stamp of the frame if `proved`, else the latest time at which it may have
    been received: that of the call. `stamp` is the last time stamp that was taken.
    """

    __slots__ = ("now", "proved", "received", "stamp")

    def __init__(self) -> None:
        self.now = self.received = 0.0
        self.stamp = -NEVER
        self.proved = False

    def stamped(self, stamp: float) -> None:
        """The frame of the running call has a time stamp, seconds.

        Frames come in order, so one that lies a little before the last is as late as that one. One
        that lies far before it, or later than now, is of a clock that was set: not used.
        """
        last, self.stamp = self.stamp, stamp
        self.proved = last - STAMP_NOISE_S <= stamp <= self.now
        self.received = self.now
        if self.proved:
            self.received = self.stamp = max(last, stamp)
