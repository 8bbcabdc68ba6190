"""A CAN bus inside the process, in simulated time: deterministic, without threads or sockets."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

from canfb.device.frame import Frame


class Participant(Protocol):
    """What can be attached: a sans-I/O device."""

    def start(self, now: float) -> list[Frame]:
        """Power-on."""

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """A frame of another participant."""

    def tick(self, now: float) -> list[Frame]:
        """What is due."""

    def deadline(self) -> float | None:
        """When tick is wanted."""


@runtime_checkable
class Computing(Protocol):
    """A participant with something to compute now and then, as the module is."""

    def pending_job(self) -> Any:
        """What is to be computed, None for nothing."""

    def finish_job(self, job: Any, result: Any, now: float) -> list[Frame]:
        """What came out."""


def frame_bits(data_bytes: int) -> int:
    """Bits of an 11-bit data frame on the wire, the most stuff bits and the interframe space included."""
    return 47 + 8 * data_bytes + (34 + 8 * data_bytes - 1) // 4


class EmbeddedBus:
    """Delivers every frame to all other participants, in the order of sending, at once.

    ``now`` is the simulated time in seconds; ``bits`` and ``frames`` count what went over
    the bus, for its load. ``taps`` are called with every frame and its time. What a participant
    wants computed is computed at once: no simulated time passes, unless ``computes`` is False.
    """

    def __init__(self) -> None:
        self.now = 0.0
        self.bits = 0
        self.frames = 0
        self.computes = True
        self.taps: list[Callable[[Frame, float], None]] = []
        self._participants: list[Participant] = []
        self._computing: list[tuple[Participant, Computing]] = []
        self._queue: deque[tuple[Participant | None, Frame]] = deque()

    def attach(self, participant: Participant) -> None:
        """Attach a device and power it on."""
        self._participants.append(participant)
        if isinstance(participant, Computing):
            self._computing.append((participant, participant))
        self._put(participant, participant.start(self.now))
        self._deliver()

    def send(self, frame: Frame) -> None:
        """Send a frame from outside; everything it causes at this instant happens before the return."""
        self._queue.append((None, frame))
        self._deliver()

    def run_until(self, time_s: float) -> None:
        """Let simulated time pass."""
        while True:
            due = [(deadline, p) for p in self._participants if (deadline := p.deadline()) is not None]
            at, first = min(due, key=lambda pair: pair[0], default=(time_s, None))
            if first is None or at > time_s:
                break
            self.now = max(self.now, at)
            self._put(first, first.tick(self.now))
            self._deliver()
        self.now = max(self.now, time_s)

    def _compute(self) -> None:
        for participant, computing in self._computing:
            job = computing.pending_job()
            if job is not None and self.computes:
                self._put(participant, computing.finish_job(job, job(), self.now))

    def _put(self, sender: Participant, frames: list[Frame]) -> None:
        self._queue.extend((sender, frame) for frame in frames)

    def _deliver(self) -> None:
        queue = self._queue
        while queue:
            sender, frame = queue.popleft()
            self.frames += 1
            self.bits += frame_bits(len(frame.data))
            for tap in self.taps:
                tap(frame, self.now)
            for participant in self._participants:
                if participant is not sender:
                    self._put(participant, participant.receive(frame, self.now))
            if not queue:
                self._compute()
