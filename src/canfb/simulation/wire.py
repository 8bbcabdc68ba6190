"""Frames on the wire: how long they are, which one comes first, and how long it takes."""

from __future__ import annotations

from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Any

from canfb.cia301.frame import Frame, frame_bits
from canfb.device.core import NEVER

INTERFRAME_BITS = 3  # the bus is silent for this long after the end of a frame


LONGEST_FRAME_BITS = frame_bits(8)


@dataclass(order=True)
class Waiting:
    """A frame that waits: the lowest CAN-ID first, then the oldest."""

    can_id: int
    number: int
    frame: Frame = field(compare=False)
    sender: Any = field(compare=False)


class Wire:
    """A bus of ``bit_rate`` bit/s: one frame at a time, and who waits for it is chosen by CAN-ID.

    A frame is never interrupted: also the SYNC waits for the end of the one on the wire. All frames have
    the most stuff bits that there can be; a remote frame has no data on the wire.
    """

    def __init__(self, bit_rate: int) -> None:
        if not 10_000 <= bit_rate <= 1_000_000:
            raise ValueError(f"bit_rate must be 10000..1000000 bit/s, not {bit_rate!r}")
        self.bit_rate = bit_rate
        self._waiting: list[Waiting] = []
        self._numbers = 0
        self._sending: Waiting | None = None
        self._end_s = 0.0  # of the frame on the wire
        self._free_s = 0.0  # when the next one may begin

    @property
    def idle(self) -> bool:
        """Nothing is on the wire, and nothing waits."""
        return self._sending is None and not self._waiting

    @property
    def next_s(self) -> float:
        """Time of the next event, a frame that begins or ends; NEVER: none."""
        if self._sending is not None:
            return self._end_s
        return self._free_s if self._waiting else NEVER

    def put(self, frame: Frame, sender: Any) -> None:
        """Queue a frame."""
        self._numbers += 1
        heappush(self._waiting, Waiting(frame.can_id, self._numbers, frame, sender))

    def advance(self, now: float) -> tuple[Frame, Any] | None:
        """Do what happens at ``now``: the frame that has ended, with its time stamp, and its sender."""
        ended = None
        if self._sending is not None and now >= self._end_s:
            ended = self._sending.frame._replace(timestamp=self._end_s), self._sending.sender
            self._sending = None
        elif self._sending is None and self._waiting and now >= self._free_s:
            self._sending = heappop(self._waiting)
            frame = self._sending.frame
            bits = frame_bits(0 if frame.rtr else len(frame.data))
            self._end_s = now + (bits - INTERFRAME_BITS) / self.bit_rate
            self._free_s = now + bits / self.bit_rate
        return ended
