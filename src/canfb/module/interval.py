"""How long an interval of SYNC is, as its clock says (canfb.timing), for all that speaks in seconds."""

from __future__ import annotations

from canfb.device.od.dictionary import Entry
from canfb.timing.sync_clock import SyncClock

SECONDS_PER_US = 1e-6


class SamplingInterval:
    """The interval of SYNC, seconds, and that from one sample to the next; 0.0 while it is not known.

    The communication cycle period 1006h counts until SYNC is measured, and as long as SYNC agrees with it.
    """

    __slots__ = ("_clock", "_period_us", "samples_per_sync", "speed_unit_s")

    def __init__(self, communication_cycle_period: Entry, clock: SyncClock) -> None:
        self._period_us, self._clock = communication_cycle_period, clock
        self.samples_per_sync = 1
        self.speed_unit_s = 0.0
        """The unit of the speeds of samples that bring their time; 0.0: they bring none."""

    @property
    def nominal_s(self) -> float:
        """1006h, 0.0: not written."""
        return float(self._period_us.value) * SECONDS_PER_US

    @property
    def measured_s(self) -> float:
        """As it is measured."""
        return self._clock.period_s

    @property
    def known_s(self) -> float:
        """Where it is certain enough for limits."""
        return self.speed_unit_s * self.samples_per_sync or self._clock.period_s or self.nominal_s

    @property
    def seconds(self) -> float:
        """The best that is known: measured, 1006h, or the median of the first intervals."""
        return self.known_s or self._clock.rough_s

    @property
    def sample_s(self) -> float:
        """The sampling interval, in which speeds are given: that of SYNC, divided by the samples in it."""
        return self.seconds / self.samples_per_sync
