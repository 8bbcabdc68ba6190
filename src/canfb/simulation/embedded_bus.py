"""A CAN bus inside the process, in simulated time: deterministic, without threads or sockets; SYNC producers.

A SYNC is sent at n T plus a deviation that does not accumulate: jitter, and the wait for the frame on the
wire. With a bit rate the waiting frame with the lowest CAN-ID is sent first, takes bits / bit rate, and is
received at its end.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Any

import numpy as np

from canfb.checks import integer_in, number_in, within
from canfb.cia301 import cob
from canfb.cia301.frame import Frame, frame_bits
from canfb.device.core import NEVER
from canfb.device.node import Computing, Device

LONGEST_FRAME_BITS = frame_bits(8)
CUT_OFF = 4.0  # largest normal jitter, standard deviations
LARGEST_PART = 0.45  # largest deviation of a SYNC, part of the period: SYNCs keep their order


@dataclass(frozen=True, kw_only=True)
class SyncTiming:
    """Deviations of a producer's SYNCs from equidistance; default: none.

    sync_jitter_us      of the producer, uniform within +-, 0..1e6 us
    sync_jitter_rms_us  of the producer, normal, cut off at 4 times that, 0..1e6 us; both add up
    sync_drift_ppm      rate error of its clock, -10000..10000 ppm, positive: fast
    bus_load            by other frames, 0..1: the SYNC waits for the end of the one on the wire, up to 135
                        bit times
    bus_bit_rate        bit/s of that bus, 10000..1000000

    ValueError for anything else.
    """

    sync_jitter_us: float = 0.0
    sync_jitter_rms_us: float = 0.0
    sync_drift_ppm: float = 0.0
    bus_load: float = 0.0
    bus_bit_rate: int = 1_000_000

    def __post_init__(self) -> None:
        within(
            self,
            sync_jitter_us=(0.0, 1e6),
            sync_jitter_rms_us=(0.0, 1e6),
            sync_drift_ppm=(-10_000.0, 10_000.0),
            bus_load=(0.0, 1.0),
            bus_bit_rate=(10_000, 1_000_000),
        )


REGULAR = SyncTiming()


def is_sync(frame: Frame, cob_id: int = cob.SYNC) -> bool:
    return frame.can_id == cob_id & cob.CAN_ID and not frame.rtr


class SimulatedDevice:
    """A device that sends a frame at ``_next_s`` (None: never); base of the simulated devices."""

    _next_s: float | None = None

    def start(self, now: float) -> list[Frame]:
        return []

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        return []

    def deadline(self) -> float | None:
        return self._next_s

    def tick(self, now: float, until: float = NEVER) -> list[Frame]:
        return (
            [] if self._next_s is None or min(now, until) < self._next_s else [self._due(self._next_s, now)]
        )

    def _due(self, due_s: float, now: float) -> Frame:
        raise NotImplementedError


class SyncProducer(SimulatedDevice):
    """Sends a SYNC every ``period_s`` seconds from power-on; overdue ones are skipped."""

    def __init__(self, period_s: float, timing: SyncTiming = REGULAR, seed: int = 1) -> None:
        number_in("period_s", period_s, 1e-6, 1e6)
        self.period_s, self._timing = period_s, timing
        self._true_s = period_s / (1.0 + timing.sync_drift_ppm * 1e-6)  # the period in true time
        self._rng = np.random.default_rng((seed, 0x80))

    def start(self, now: float) -> list[Frame]:
        self._start_s, self._number = now, 0
        self._plan(now)
        return []

    def _due(self, due_s: float, now: float) -> Frame:
        self._plan(now)
        return Frame(cob.SYNC, b"")

    def _plan(self, now: float) -> None:
        # 1e-6 of a period covers the rounding of times up to a day.
        self._number = max(self._number, int((now - self._start_s) / self._true_s + 1e-6)) + 1
        self._next_s = max(now, self._start_s + self._number * self._true_s + self.deviation_s())

    def deviation_s(self) -> float:
        """Delay of the next SYNC (negative: early), limited to LARGEST_PART."""
        timing, rng, largest_s = self._timing, self._rng, LARGEST_PART * self.period_s
        if not (timing.sync_jitter_us or timing.sync_jitter_rms_us or timing.bus_load):
            return 0.0
        off_us = timing.sync_jitter_us * float(rng.uniform(-1.0, 1.0))
        off_us += timing.sync_jitter_rms_us * max(-CUT_OFF, min(CUT_OFF, float(rng.normal())))
        blocking_bits = (float(rng.uniform()) < timing.bus_load) * LONGEST_FRAME_BITS
        off_s = off_us * 1e-6 + blocking_bits * float(rng.uniform()) / timing.bus_bit_rate
        return max(-largest_s, min(largest_s, off_s))


POSITION_PDO = struct.Struct("<IHH")  # 6004h, 2011:01 status word, 2011:02 residual


@dataclass
class Consumed:
    """The values of the position PDOs received; positions are unwrapped, in measuring units."""

    sync_number: list[int] = field(default_factory=list)
    position_units: list[int] = field(default_factory=list)
    status: list[int] = field(default_factory=list)
    residual_cycles: list[float] = field(default_factory=list)


class Drive(SyncProducer):
    """A SYNC producer, started by `start_sync`, that unwraps the positions of ``position_cob_id``."""

    def __init__(
        self,
        sync_period_s: float,
        position_cob_id: int,
        total_range: int,
        timing: SyncTiming = REGULAR,
        seed: int = 1,
    ) -> None:
        super().__init__(sync_period_s, timing, seed)
        self.total_range = total_range
        self.syncs = 0
        self.consumed = Consumed()
        self._position_cob_id = position_cob_id

    def start(self, now: float) -> list[Frame]:
        return []

    def start_sync(self, now: float) -> None:
        self._start_s = self._next_s = now
        self._number = self.syncs = 0

    def _due(self, due_s: float, now: float) -> Frame:
        self.syncs += 1
        return super()._due(due_s, now)

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        if frame.can_id == self._position_cob_id and len(frame.data) == POSITION_PDO.size:
            position, status, residual = POSITION_PDO.unpack(frame.data)
            consumed, half = self.consumed, self.total_range // 2
            last = consumed.position_units[-1] if consumed.position_units else position
            consumed.position_units.append(last + (position - last + half) % self.total_range - half)
            consumed.sync_number.append(self.syncs)
            consumed.status.append(status)
            consumed.residual_cycles.append(residual / 65536)
        return []


WINDOW_S, WINDOW_SYNCS = 2.0, 100  # the rate is measured over the longer of the two
TOLERANCE = 0.02
AGAIN_S = 60.0
IN_TRUE_TIME = "; set a lower --rate, or --pace sync"
IN_SLOW_MOTION = ", and the machine turns slower in proportion"


class WatchedSyncProducer(SyncProducer):
    """Calls ``report``, at most once a minute, if another node sends SYNC or its own rate is off by 2 %."""

    def __init__(
        self,
        period_s: float,
        report: Callable[[str], None],
        advice: str = IN_TRUE_TIME,
        timing: SyncTiming = REGULAR,
        seed: int = 1,
    ) -> None:
        super().__init__(period_s, timing, seed)
        self._report = report
        self._advice = advice
        self._window_s = max(WINDOW_S, WINDOW_SYNCS * period_s)
        self._began_s = -math.inf  # start of the window; -inf before the first one
        self._own = self._foreign = 0
        self._said_s = -math.inf

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        self._foreign += is_sync(frame)
        return []

    def bus_off(self, now: float) -> list[Frame]:
        self._said_s = math.inf
        return []

    def bus_back(self, now: float) -> list[Frame]:
        self._said_s = self._began_s = -math.inf
        return []

    def _due(self, due_s: float, now: float) -> Frame:
        self._own += 1
        passed = now - self._began_s
        if passed >= self._window_s:
            if passed < math.inf:
                self._judge(self._own / passed, self._foreign / passed, now)
            self._began_s, self._own, self._foreign = now, 0, 0
        return super()._due(due_s, now)

    def _judge(self, own_hz: float, foreign_hz: float, now: float) -> None:
        asked_hz = 1.0 / self.period_s
        if foreign_hz:
            said = (
                f"another node sends it too, {foreign_hz:.4g} Hz beside the {asked_hz:.4g} Hz sent here; end "
                "one of the two"
            )
        elif abs(own_hz / asked_hz - 1.0) > TOLERANCE:
            said = (
                f"{own_hz:.4g} Hz reached, {asked_hz:.4g} Hz requested: this computer does not keep up"
                f"{self._advice}"
            )
        else:
            return
        if now - self._said_s >= AGAIN_S:
            self._said_s = now
            self._report(f"SYNC: {said}")


CAN_ID = 0x6E0  # of background traffic: no node and no service of CiA 301 uses it
MEAN_BITS = sum(frame_bits(size) for size in range(9)) / 9
HIGHEST_LOAD = 0.95
INTERFRAME_BITS = 3  # interframe space after a frame


# CAN-ID, consecutive number, frame and sender: the lowest CAN-ID goes first, then the oldest frame.
Waiting = tuple[int, int, Frame, Any]


class Wire:
    """A bus of ``bit_rate`` bit/s, one frame at a time, each with the largest number of stuff bits."""

    def __init__(self, bit_rate: int) -> None:
        integer_in("bit_rate", bit_rate, 10_000, 1_000_000)
        self.bit_rate = bit_rate
        self._waiting: list[Waiting] = []
        self._numbers = 0
        self._sending: Waiting | None = None
        self._end_s = 0.0  # end of the frame on the wire
        self._free_s = 0.0  # time at which the next frame may begin

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
        """End or begin a frame, from ``next_s`` on; returns the ended one, time-stamped, and its sender."""
        if self._sending is not None:
            _, _, frame, sender = self._sending
            self._sending = None
            return frame._replace(timestamp=self._end_s), sender
        self._sending = heappop(self._waiting)
        frame = self._sending[2]
        bits = frame_bits(0 if frame.rtr else len(frame.data))
        self._end_s = now + (bits - INTERFRAME_BITS) / self.bit_rate
        self._free_s = now + bits / self.bit_rate
        return None


LONGEST_WAIT_S = 1.0


class EmbeddedBus:
    """Delivers every frame to all others, at once or by a :class:`Wire` of ``bit_rate``, 10000..1000000
    bit/s.

    ``now`` is the simulated time, ``bits`` the number transmitted; ``observers`` are called with each frame
    and its time. Jobs of participants take no simulated time; ``computes`` False: they are not run.
    """

    def __init__(self, bit_rate: int | None = None) -> None:
        self.now = 0.0
        self.bits = 0
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
        self._deliver(participant, participant.start(self.now))

    def send(self, frame: Frame) -> None:
        """Send a frame from outside; returns after everything that it causes.

        With a bit rate time passes until the bus is idle, at most 1 s, except if a participant calls this.
        """
        self._deliver(None, [frame])
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
                    self._deliver(first, first.tick(at))
                elif wire is not None and (ended := wire.advance(at)) is not None:
                    self._hand_out(*ended)
                    self._compute()
        finally:
            self._running = False

    def _compute(self) -> None:
        for participant, computing in self._computing:
            if self.computes and (job := computing.pending_job()) is not None:
                self._put(participant, computing.finish_job(job, job(), self.now))

    def _put(self, sender: Device | None, frames: list[Frame]) -> None:
        if self._wire is None:
            self._queue.extend((sender, frame) for frame in frames)
        else:
            for frame in frames:
                self._wire.put(frame, sender)

    def _deliver(self, sender: Device | None, frames: list[Frame]) -> None:
        """Deliver these frames, and all that they cause."""
        self._put(sender, frames)
        queue = self._queue
        while queue:
            sender, frame = queue.popleft()
            self._hand_out(frame, sender)
            if not queue:
                self._compute()

    def _hand_out(self, frame: Frame, sender: Device | None) -> None:
        self.bits += frame_bits(len(frame.data))
        now = self.now
        for observer in self.observers:
            observer(frame, now)
        for participant in self._participants:
            if participant is not sender and (answers := participant.receive(frame, now)):
                self._put(participant, answers)


class BackgroundTraffic(SimulatedDevice):
    """Frames of 0 to 8 bytes at random times, with the bus load ``load``, 0..0.95."""

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
