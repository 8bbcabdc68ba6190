"""A CAN bus inside the process, in simulated time: deterministic, without threads or sockets.

With a bit rate the lowest CAN-ID that waits goes first, takes its bits / bit rate, and is received at its
end.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from heapq import heappop, heappush
from typing import Any

import numpy as np

from canfb.checks import number_in
from canfb.cia301.frame import Frame, frame_bits
from canfb.device.core import NEVER
from canfb.device.device_protocol import Computing, Device
from canfb.simulation.sync_producer import PacedDevice

CAN_ID = 0x6E0  # of background traffic: of no node and of no service of CiA 301
MEAN_BITS = sum(frame_bits(size) for size in range(9)) / 9
HIGHEST_LOAD = 0.95
INTERFRAME_BITS = 3  # the bus is silent for this long after the end of a frame


Waiting = tuple[int, int, Frame, Any]
"""A frame that waits, and its sender: the lowest CAN-ID first, then the oldest, by a number."""


class Wire:
    """A bus of ``bit_rate`` bit/s, one frame at a time, each with the most stuff bits that there can be."""

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
        return self._sending is None and not self._waiting

    @property
    def next_s(self) -> float:
        if self._sending is not None:
            return self._end_s
        return self._free_s if self._waiting else NEVER

    def put(self, frame: Frame, sender: Any) -> None:
        self._numbers += 1
        heappush(self._waiting, (frame.can_id, self._numbers, frame, sender))

    def advance(self, now: float) -> tuple[Frame, Any] | None:
        """Do what happens at ``now``: the frame that has ended, with its time stamp, and its sender."""
        ended = None
        if self._sending is not None and now >= self._end_s:
            _, _, frame, sender = self._sending
            ended = frame._replace(timestamp=self._end_s), sender
            self._sending = None
        elif self._sending is None and self._waiting and now >= self._free_s:
            self._sending = heappop(self._waiting)
            frame = self._sending[2]
            bits = frame_bits(0 if frame.rtr else len(frame.data))
            self._end_s = now + (bits - INTERFRAME_BITS) / self.bit_rate
            self._free_s = now + bits / self.bit_rate
        return ended


LONGEST_WAIT_S = 1.0


class EmbeddedBus:
    """Delivers every frame to all others, at once or by a :class:`Wire` of ``bit_rate``, 10000..1000000
    bit/s.

    ``now`` is the simulated time, ``bits`` and ``frames`` went over the bus, ``observers`` are called with
    each frame and its time. What a participant computes takes no simulated time; ``computes`` False: never
    done.
    """

    def __init__(self, bit_rate: int | None = None) -> None:
        self.now = 0.0
        self.bits = 0
        self.frames = 0
        self.computes = True
        self.observers: list[Callable[[Frame, float], None]] = []
        self._participants: list[Device] = []
        self._computing: list[tuple[Device, Computing]] = []
        self._queue: deque[tuple[Device | None, Frame]] = deque()
        self._wire = None if bit_rate is None else Wire(bit_rate)
        self._running = False

    def attach(self, participant: Device) -> None:
        self._participants.append(participant)
        if isinstance(participant, Computing):
            self._computing.append((participant, participant))
        self._put(participant, participant.start(self.now))
        self._deliver()

    def send(self, frame: Frame) -> None:
        """Send a frame from outside; everything it causes happens before the return.

        With a bit rate time passes until the bus is idle, at most 1 s, but not from within a participant.
        """
        self._put(None, [frame])
        self._deliver()
        if self._wire is not None and not self._running:
            self._run(self.now + LONGEST_WAIT_S, until_idle=True)

    def run_until(self, time_s: float) -> None:
        self._run(time_s)
        self.now = max(self.now, time_s)

    def _run(self, time_s: float, *, until_idle: bool = False) -> None:
        wire, self._running = self._wire, True
        try:
            while not (until_idle and wire is not None and wire.idle):
                due = [(deadline, p) for p in self._participants if (deadline := p.deadline()) is not None]
                at, first = min(due, key=lambda pair: pair[0], default=(NEVER, None))
                at = max(self.now, at)
                if wire is not None and (wire_at := max(self.now, wire.next_s)) < at:
                    at, first = wire_at, None
                if at > time_s:
                    break
                self.now = at
                if first is not None:
                    self._put(first, first.tick(at))
                    self._deliver()
                elif wire is not None:
                    self._advance(wire)
        finally:
            self._running = False

    def _advance(self, wire: Wire) -> None:
        ended = wire.advance(self.now)
        if ended is not None:
            frame, sender = ended
            self._hand_out(frame, sender)
            self._compute()

    def _compute(self) -> None:
        for participant, computing in self._computing:
            job = computing.pending_job()
            if job is not None and self.computes:
                self._put(participant, computing.finish_job(job, job(), self.now))

    def _put(self, sender: Device | None, frames: list[Frame]) -> None:
        if self._wire is None:
            self._queue.extend((sender, frame) for frame in frames)
        else:
            for frame in frames:
                self._wire.put(frame, sender)

    def _deliver(self) -> None:
        queue = self._queue
        while queue:
            sender, frame = queue.popleft()
            self._hand_out(frame, sender)
            if not queue:
                self._compute()

    def _hand_out(self, frame: Frame, sender: Device | None) -> None:
        self.frames += 1
        self.bits += frame_bits(len(frame.data))
        now = self.now
        for observer in self.observers:
            observer(frame, now)
        for participant in self._participants:
            if participant is not sender and (answers := participant.receive(frame, now)):
                self._put(participant, answers)


class BackgroundTraffic(PacedDevice):
    """Frames of 0 to 8 bytes at random times that load a bus for a part ``load`` of the time, 0..0.95."""

    def __init__(self, load: float, bit_rate: int, seed: int = 1) -> None:
        number_in("load", load, 0.0, HIGHEST_LOAD)
        self._rng = np.random.default_rng((seed, CAN_ID))
        self._mean_gap_s = MEAN_BITS / bit_rate / load if load else None

    def start(self, now: float) -> list[Frame]:
        self._plan(now)
        return []

    def _due(self, due_s: float, now: float) -> Frame:
        self._plan(due_s)
        return Frame(CAN_ID, self._rng.bytes(int(self._rng.integers(9))))

    def _plan(self, after_s: float) -> None:
        if self._mean_gap_s is not None:
            self._next_s = after_s + float(self._rng.exponential(self._mean_gap_s))
