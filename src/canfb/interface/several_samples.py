"""The samples of one interval of SYNC: an interface that samples by its own clock, locked to SYNC."""

from __future__ import annotations

from canfb.interface.sample_clock import TICKS_PER_S
from canfb.signal.nominal_sync import NominalSync
from canfb.signal.sample import TICKS, Sample
from canfb.sources.protocol import Machine, Source

LOCK_SYNCS = 4096  # that the clock of the interface is locked to
EARLIER_PART = 1.0 / 16.0  # of the interval: so long before the nominal SYNC the newest sample is taken


class SeveralSamples:
    """Gives ``per_sync`` samples, 1..4, of a machine or a recording for each SYNC, in one.

    The sampling instants of a machine do not jitter with SYNC: they lie on a grid that is locked to it, the
    newest one shortly before SYNC. Where SYNC is earlier than that, the newest sample is taken at SYNC. The
    first SYNC measures no interval, and has no samples. A recording has ``per_sync`` samples for each SYNC.
    """

    def __init__(self, source: Source, per_sync: int) -> None:
        self._source = source
        self._machine = source if isinstance(source, Machine) else None
        self._per_sync = per_sync
        self._lock = NominalSync(LOCK_SYNCS)
        self._last_s: float | None = None
        self._taken_s: float | None = None
        self.newest_s = 0.0
        """When the newest sample was taken, in the time of the machine, seconds."""

    def at_sync(self, heard_s: float) -> Sample | None:
        """The samples for the SYNC that was heard at this time; None where one of them is missing.

        What ``source`` raises.
        """
        if self._machine is None:
            self.newest_s = heard_s
            return _together([self._source.next() for _ in range(self._per_sync)], None)
        last, self._last_s = self._last_s, heard_s
        self._lock.sample(round(heard_s * TICKS_PER_S) % TICKS)
        if last is None or not heard_s > last:
            return None
        period_s, lead_s = heard_s - last, 0.0
        if self._lock.locked:
            period_s, lead_s = self._lock.period_ticks / TICKS_PER_S, self._lock.lead_ticks / TICKS_PER_S
        newest_s = min(heard_s + lead_s - EARLIER_PART * period_s, heard_s)
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
