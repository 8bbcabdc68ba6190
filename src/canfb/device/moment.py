"""The time of the running call, and what the services of a node do with times and frames."""

from __future__ import annotations

from collections.abc import Callable

from canfb.cia301.frame import Frame

NEVER = float("inf")
"""The deadline of a service that waits for nothing, seconds."""

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
        that lies far before it, or later than now, is of a clock that was set: not used, nor is any
        other that lies before this call. A clock that was set back is used again when it is right.
        """
        last = self.stamp
        self.proved = last - STAMP_NOISE_S <= stamp <= self.now
        self.received = self.stamp = max(last, stamp) if self.proved else self.now
