"""What goes in and comes out of the device, and the time of the running call."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

NEVER = float("inf")
"""The deadline of a service that waits for nothing, seconds."""


class Frame(NamedTuple):
    """One CAN frame with an 11-bit identifier.

    `data` holds 0 to 8 bytes (more is dropped by the device). `timestamp` is the time of
    reception in seconds where the bus gives one; the device does not use it.
    """

    can_id: int
    data: bytes
    rtr: bool = False
    timestamp: float | None = None


Emit = Callable[[Frame], None]
"""How a service sends a frame."""


class Moment:
    """The `now` of the running call, seconds.

    The hooks of an SDO write carry no time, yet a timer that such a write starts needs one. The
    node sets it at each call from its argument; nothing here reads a clock.
    """

    __slots__ = ("now",)

    def __init__(self) -> None:
        self.now = 0.0
