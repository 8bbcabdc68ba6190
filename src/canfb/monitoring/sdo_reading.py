"""Reading small objects of a node by SDO, without waiting: requests out, answers in (CiA 301, 7.2.4.3.3)."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import NamedTuple

from canfb import objects as od
from canfb.cia301 import cob
from canfb.cia301.frame import Frame
from canfb.monitoring.layout import COUNTERS, SETTINGS, VALUES
from canfb.objects import Multiplexer
from canfb.view.pdo_map import Number

UPLOAD, EXPEDITED, ABORT = 0x40, 0x43, 0x80
ANSWER_S = 0.3
CYCLE_S = 1.0
QUIET_S = 5.0  # after several requests without an answer
MOST_UNANSWERED = 3
HEAD = struct.Struct("<BHB4s")
REPEATED = (
    od.FEEDBACK_STATUS,
    od.FEEDBACK_AMPLITUDE,
    od.FEEDBACK_VELOCITY,
    od.FEEDBACK_NOISE,
    od.TABLE_ACTIVE_CRC,
    od.COUNTER_LOSS_CAUSE,
    *COUNTERS,
)
"""What is read again and again: what the default PDOs do not carry."""


class _Request(NamedTuple):
    place: Multiplexer
    sent_s: float


class SdoReading:
    """Reads the :data:`.SETTINGS` of a module (1..127) once, then :data:`REPEATED` every second.

    One request at a time. A node that does not answer is left alone for QUIET_S. It is a second SDO client
    beside a master that uses the same channel at the same time.
    """

    def __init__(self, node_id: int) -> None:
        self.node_id = node_id
        self.settings: dict[Multiplexer, Number | None] = {}
        self._waiting: list[Multiplexer] = [*SETTINGS]
        self._request: _Request | None = None
        self._not_before_s = self._next_cycle_s = -float("inf")
        self._unanswered = 0

    @property
    def complete(self) -> bool:
        """All settings were asked for, and at least one was there."""
        return len(self.settings) == len(SETTINGS) and any(one is not None for one in self.settings.values())

    def next(self, now: float) -> Frame | None:
        """The next request, if it is time for one."""
        request = self._request
        if request is not None:
            if now - request.sent_s < ANSWER_S:
                return None
            self._request = None
            self._waiting.insert(0, request.place)
            self._unanswered += 1
            if self._unanswered >= MOST_UNANSWERED:
                self._unanswered, self._not_before_s = 0, now + QUIET_S
        if now < self._not_before_s:
            return None
        if not self._waiting:
            if now < self._next_cycle_s:
                return None
            self._waiting, self._next_cycle_s = [*REPEATED], now + CYCLE_S
        place = self._waiting.pop(0)
        self._request = _Request(place, now)
        return Frame(cob.SDO_REQUEST + self.node_id, HEAD.pack(UPLOAD, *place, bytes(4)))

    def receive(self, frame: Frame) -> Mapping[Multiplexer, Number]:
        """A frame of the bus; the values that it brings."""
        request = self._request
        if request is None or frame.can_id != cob.SDO_RESPONSE + self.node_id or len(frame.data) != HEAD.size:
            return {}
        command, index, subindex, data = HEAD.unpack(frame.data)
        if Multiplexer(index, subindex) != request.place:
            return {}
        self._request, self._unanswered = None, 0
        value = _value(request.place, command, data)
        if request.place in SETTINGS:
            self.settings[request.place] = value
        return {} if value is None or request.place not in VALUES else {request.place: value}


def _value(place: Multiplexer, command: int, data: bytes) -> Number | None:
    """What an expedited answer holds; None for an abort, or for what is not of the type."""
    packed = struct.Struct(f"<{(SETTINGS | VALUES)[place]}")
    if command & ~0x0C != EXPEDITED or 4 - (command >> 2 & 3) != packed.size:
        return None
    value: Number = packed.unpack_from(data)[0]
    return value
