"""A CAN bus inside the process, in simulated time: deterministic, without threads or sockets."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from canfb.cia301.frame import Frame, frame_bits
from canfb.device.core import NEVER
from canfb.device.device_protocol import Computing, Device
from canfb.simulation.wire import Wire

__all__ = ["EmbeddedBus", "frame_bits"]

LONGEST_WAIT_S = 1.0


class EmbeddedBus:
    """Delivers every frame to all other participants, in the order of sending.

    Without a ``bit_rate`` at once. With one (10000..1000000 bit/s) a frame takes its time on the wire, and
    waits for the one before it: see :class:`canfb.simulation.wire.Wire`. It is received at its end, which
    is its time stamp, too.

    ``now`` is the simulated time in seconds; ``bits`` and ``frames`` count what went over the bus, for its
    load. ``taps`` are called with every frame and its time. What a participant wants computed is computed
    at once: no simulated time passes, unless ``computes`` is False.
    """

    def __init__(self, bit_rate: int | None = None) -> None:
        self.now = 0.0
        self.bits = 0
        self.frames = 0
        self.computes = True
        self.taps: list[Callable[[Frame, float], None]] = []
        self._participants: list[Device] = []
        self._computing: list[tuple[Device, Computing]] = []
        self._queue: deque[tuple[Device | None, Frame]] = deque()
        self._wire = None if bit_rate is None else Wire(bit_rate)
        self._running = False

    def attach(self, participant: Device) -> None:
        """Attach a device and power it on."""
        self._participants.append(participant)
        if isinstance(participant, Computing):
            self._computing.append((participant, participant))
        self._put(participant, participant.start(self.now))
        self._deliver()

    def send(self, frame: Frame) -> None:
        """Send a frame from outside; everything it causes happens before the return.

        Without a bit rate all of it is at this instant. With one, time passes until the bus is idle, at
        most 1 s; from within a participant or a tap the frame is put behind those that wait.
        """
        self._put(None, [frame])
        self._deliver()
        if self._wire is not None and not self._running:
            self._run(self.now + LONGEST_WAIT_S, until_idle=True)

    def run_until(self, time_s: float) -> None:
        """Let simulated time pass."""
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
        """Hand out what is in the queue, at once: there is no wire."""
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
        for tap in self.taps:
            tap(frame, now)
        for participant in self._participants:
            if participant is not sender and (answers := participant.receive(frame, now)):
                self._put(participant, answers)
