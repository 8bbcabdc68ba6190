"""When a node beside a machine samples: time of its machine, its clock, several samples for each SYNC."""

from __future__ import annotations

import math
from typing import Protocol

from canfb.cia301.frame import Frame
from canfb.device.node import NodeDevice
from canfb.signal.sample import TICKS, Sample
from canfb.sources.protocol import Machine, Source
from canfb.timing.grid import Grid

OLDEST_S = 10.0


class TimeBase(Protocol):
    """The time of the machine, as a node has it; one that is simulated may be another than the true time."""

    def received_at(self, frame: Frame, now: float) -> float:
        """The time of the machine, seconds, at which ``frame`` was received that is handled at ``now``."""

    def at(self, now: float) -> float:
        """The time of the machine, seconds, at ``now``."""


class TrueTime:
    """The machine turns in true time: at the clock of the bus where there is one."""

    def received_at(self, frame: Frame, now: float) -> float:
        """Receive time on the clock of ``now``; a time stamp ahead of it, or 10 s behind, is of another
        clock: ``now``.
        """
        stamp = frame.timestamp
        return now if stamp is None or not now - OLDEST_S <= stamp <= now else stamp

    def at(self, now: float) -> float:
        return now


TRUE_TIME = TrueTime()


TICKS_PER_S = 10_000_000  # units of 100 ns
LARGEST_DRIFT_PPM = 10_000.0


class SampleClock:
    """Counts units of 100 ns as U32, which wraps each 429.5 s; it is never set and never stopped.

    drift_ppm     how much faster than the true time it runs, -10000..10000 ppm; a crystal has up to 100
    start_100ns   what it shows at the time 0 of the node, any integer

    ValueError for anything else.
    """

    def __init__(self, drift_ppm: float = 0.0, start_100ns: int = 0) -> None:
        if not -LARGEST_DRIFT_PPM <= drift_ppm <= LARGEST_DRIFT_PPM:
            raise ValueError(f"drift_ppm must be a number -10000..10000, not {drift_ppm!r}")
        self._start = start_100ns
        self._rate = TICKS_PER_S * (1.0 + drift_ppm * 1e-6)

    def ticks(self, now: float) -> int:
        return (self._start + math.floor(now * self._rate)) % TICKS


LOCK_SYNCS = 4096  # that the clock of the interface is locked to
EARLIER_PART = 1.0 / 16.0  # of the interval: so long before the nominal SYNC the newest sample is taken


class SeveralSamples:
    """Gives ``per_sync`` samples, 1..8, of a machine or a recording for each SYNC, in one.

    Those of a machine lie on a grid that is locked to SYNC, the newest one shortly before it, or at a SYNC
    that is earlier. The first SYNC measures no interval, and has no samples.
    """

    def __init__(self, source: Source, per_sync: int) -> None:
        self._source = source
        self._machine = source if isinstance(source, Machine) else None
        self._per_sync = per_sync
        self._grid = Grid(LOCK_SYNCS)
        self._last_s: float | None = None
        self._taken_s: float | None = None
        self.newest_s = 0.0
        """When the newest sample was taken, in the time of the machine, seconds."""

    def at_sync(self, received_s: float) -> Sample | None:
        """The samples for the SYNC that was received at this time; None where one of them is missing.

        What ``source`` raises.
        """
        if self._machine is None:
            self.newest_s = received_s
            return _together([self._source.next() for _ in range(self._per_sync)], None)
        last, self._last_s = self._last_s, received_s
        self._grid.take(received_s)
        if last is None or not received_s > last:
            return None
        period_s, lead_s = received_s - last, 0.0
        if self._grid.locked:
            period_s, lead_s = self._grid.period, self._grid.lead
        newest_s = min(received_s + lead_s - EARLIER_PART * period_s, received_s)
        apart_s = period_s / self._per_sync
        instants = [newest_s - earlier * apart_s for earlier in range(self._per_sync - 1, -1, -1)]
        before, self._taken_s, self.newest_s = self._taken_s, newest_s, newest_s
        if before is not None and instants[0] <= before:  # SYNCs too near together for the grid
            return None
        samples = [self._machine.sample_at(instant) for instant in instants]
        return _together(samples, None if before is None else [one - before for one in instants])


def _together(samples: list[Sample | None], passed_s: list[float] | None) -> Sample | None:
    """One sample of all; ``passed_s`` is how long after the last of the SYNC before each was taken."""
    there = [one for one in samples if one is not None]
    if len(there) < len(samples):
        return None
    *earlier, newest = there
    pulse = newest.zero_pulse
    if passed_s is not None:
        begins = [0.0, *passed_s[:-1]]
        places = [
            (begin + one.zero_pulse * (end - begin)) / passed_s[-1]
            for one, begin, end in zip(there, begins, passed_s, strict=True)
            if one.zero_pulse is not None
        ]
        pulse = places[-1] if places else None
    pairs = tuple((one.sine, one.cosine) for one in reversed(earlier))
    return newest._replace(zero_pulse=pulse, earlier=pairs)


class MachineNode(NodeDevice):
    """``received_s``: when the frame was received that is handled now, in the time of the machine."""

    time_base: TimeBase = TRUE_TIME
    received_s = 0.0

    def machine_now(self) -> float:
        return self.time_base.at(self.now)

    def start(self, now: float) -> list[Frame]:
        self.received_s = self.time_base.at(now)
        return super().start(now)

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        self.call.now = now
        self.received_s = self.time_base.received_at(frame, now)
        self.overhear(frame)
        return super().receive(frame, now)

    def tick(self, now: float) -> list[Frame]:
        self.call.now = now
        self.received_s = self.time_base.at(now)
        self.time_passed()
        return super().tick(now)

    def overhear(self, frame: Frame) -> None:
        """Before :meth:`receive`."""

    def time_passed(self) -> None:
        """Before a tick."""
