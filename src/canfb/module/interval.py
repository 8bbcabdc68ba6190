"""The length of an interval of SYNC, by its grid (canfb.timing), for all results and limits in seconds."""

from __future__ import annotations

from canfb.device.od.dictionary import Entry
from canfb.signal.chain import SignalChain
from canfb.signal.sample import TICK_S
from canfb.timing.syncs import Syncs

SECONDS_PER_US = 1e-6
SAME_GRID = 2e-6  # relative difference up to which an interval is the same
EXACT_SYNCS = 512  # samples after which the line is more exact than 1006h with the drift of a clock
AGREES = 0.3  # relative difference to 1006h that jitter causes in the median of a few intervals
CLOSE = 2e-3  # relative difference to 1006h that the first line may have


class SamplingInterval:
    """The interval of SYNC, seconds, and that from one sample to the next; 0.0 while it is not known.

    The communication cycle period 1006h is used until SYNC is measured, unless SYNC contradicts it.
    """

    __slots__ = ("_period_us", "_syncs", "samples_per_sync", "speed_unit_s")

    def __init__(self, communication_cycle_period: Entry, syncs: Syncs) -> None:
        self._period_us, self._syncs = communication_cycle_period, syncs
        self.samples_per_sync = 1
        # The sampling interval by sample times, seconds; 0.0: samples bring no time.
        self.speed_unit_s = 0.0
        syncs.expected_s = lambda: self.timed_s or self.nominal_s

    @property
    def nominal_s(self) -> float:
        """1006h; 0.0: not written."""
        return float(self._period_us.value) * SECONDS_PER_US

    @property
    def timed_s(self) -> float:
        """The interval by the sample times; 0.0: none."""
        return self.speed_unit_s * self.samples_per_sync

    @property
    def known_s(self) -> float:
        """The interval, if it is certain enough for limits."""
        measured_s = self.timed_s or self._syncs.grid.period
        if measured_s:
            return measured_s
        rough_s, nominal_s = self._syncs.grid.rough, self.nominal_s
        return nominal_s if abs(rough_s - nominal_s) <= AGREES * nominal_s or not rough_s else 0.0

    @property
    def per_sync(self) -> int:
        """Intervals by sample times in one of SYNC: 2 if every other SYNC is not received."""
        return max(1, round(self._syncs.grid.period / self.timed_s)) if self.timed_s else 1

    @property
    def seconds(self) -> float:
        """The best known value: measured, 1006h, or the median of the first intervals."""
        return self.known_s or self._syncs.grid.rough

    @property
    def sample_s(self) -> float:
        """The sampling interval, the unit of speeds: that of SYNC, divided by the samples in it."""
        return self.seconds / self.samples_per_sync


class InterfaceGrid:
    """Sets the interval over which the interface spreads several samples per SYNC, by its own clock, which
    ``chain`` learns from the sample times.
    """

    def __init__(self, chain: SignalChain, interval: SamplingInterval) -> None:
        self._chain, self._interval = chain, interval
        self.forget()

    def forget(self) -> None:
        self._learned_s, self._syncs = 0.0, 0

    def follow(self, syncs: int) -> None:
        """Call before a sample with its time. While the interval is not known, times measure no intervals.

        ``syncs`` is the number of SYNCs in the fit of their grid: fewer than before mean a new grid, and the
        position of a moving machine is lost.
        """
        learned_s, another = self._learned_s, syncs < self._syncs  # before _grid_s changes them
        grid_s, chain, self._syncs = self._grid_s(), self._chain, syncs
        # The instants of the earlier samples are not known: that does not matter at standstill.
        chain.measures_intervals = grid_s > 0.0
        if another or (learned_s and abs(grid_s - learned_s) > CLOSE * grid_s):
            chain.uncertain(1.0)
        if abs(grid_s - chain.sync_interval_s) > SAME_GRID * grid_s:
            chain.sync_interval_s = grid_s

    def _grid_s(self) -> float:
        """The interval, s; 0.0: not known yet. At first 1006h, exact but for drift, is better than the line.

        A learned interval is kept until a reset or a new line.
        """
        lock, nominal_s = self._chain.sample_grid, self._interval.nominal_s
        if lock.locked:
            learned_s = lock.period * TICK_S
            near = lock.seen < EXACT_SYNCS and abs(learned_s - nominal_s) <= CLOSE * nominal_s
            self._learned_s = nominal_s if near else learned_s
        return self._learned_s or nominal_s
