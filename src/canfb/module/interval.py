"""How long an interval of SYNC is, as its clock says (canfb.timing), for all that speaks in seconds."""

from __future__ import annotations

from canfb.device.od.dictionary import Entry
from canfb.signal.chain import SignalChain
from canfb.signal.sample import TICK_S
from canfb.timing.syncs import Syncs

SECONDS_PER_US = 1e-6
SAME_GRID = 2e-6  # of the interval
EXACT_SYNCS = 512  # from then on a lock is more exact than the drift of a clock
AGREES = 0.3  # of 1006h: the median of a few SYNCs that jitter
CLOSE = 2e-3  # of the interval: as far as the first lock may be from 1006h


class SamplingInterval:
    """The interval of SYNC, seconds, and that from one sample to the next; 0.0 while it is not known.

    The communication cycle period 1006h counts until SYNC is measured, as long as SYNC agrees with it.
    """

    __slots__ = ("_period_us", "_syncs", "samples_per_sync", "speed_unit_s")

    def __init__(self, communication_cycle_period: Entry, syncs: Syncs) -> None:
        self._period_us, self._syncs = communication_cycle_period, syncs
        self.samples_per_sync = 1
        # The unit of the speeds of samples that bring their time; 0.0: they bring none.
        self.speed_unit_s = 0.0
        syncs.expected_s = lambda: self.timed_s or self.nominal_s

    @property
    def nominal_s(self) -> float:
        """1006h, 0.0: not written."""
        return float(self._period_us.value) * SECONDS_PER_US

    @property
    def timed_s(self) -> float:
        """By the sample times; 0.0: none."""
        return self.speed_unit_s * self.samples_per_sync

    @property
    def known_s(self) -> float:
        """Where it is certain enough for limits: 1006h only while no SYNC shows that it is wrong."""
        measured_s = self.timed_s or self._syncs.grid.period
        if measured_s:
            return measured_s
        rough_s, nominal_s = self._syncs.grid.rough, self.nominal_s
        return nominal_s if abs(rough_s - nominal_s) <= AGREES * nominal_s or not rough_s else 0.0

    @property
    def per_sync(self) -> int:
        """Intervals of the sample times in one of SYNC: 2 where every other one is left out."""
        return max(1, round(self._syncs.grid.period / self.timed_s)) if self.timed_s else 1

    @property
    def seconds(self) -> float:
        """The best that is known: measured, 1006h, or the median of the first intervals."""
        return self.known_s or self._syncs.grid.rough

    @property
    def sample_s(self) -> float:
        """The sampling interval, in which speeds are given: that of SYNC, divided by the samples in it."""
        return self.seconds / self.samples_per_sync


class InterfaceGrid:
    """Several samples for each SYNC: the earlier ones were taken by its interval, by the clock of the
    interface, as ``chain`` learns it from the sample times.
    """

    def __init__(self, chain: SignalChain, interval: SamplingInterval) -> None:
        self._chain, self._interval = chain, interval
        self.forget()

    def forget(self) -> None:
        self._learned_s, self._syncs = 0.0, 0

    def follow(self, syncs: int) -> None:
        """Before a sample with its time. While the grid is not known, times measure no intervals.

        ``syncs`` carry the line of SYNC, fewer another one, which loses a machine that moves.
        """
        learned_s, another = self._learned_s, syncs < self._syncs  # before the next line learns
        grid_s, chain, self._syncs = self._grid_s(), self._chain, syncs
        # Of the earlier samples it is not known when they were taken: at standstill it does not matter.
        chain.measures_intervals = grid_s > 0.0
        if another or (learned_s and abs(grid_s - learned_s) > CLOSE * grid_s):
            chain.uncertain(1.0)
        if abs(grid_s - chain.sync_interval_s) > SAME_GRID * grid_s:
            chain.sync_interval_s = grid_s

    def _grid_s(self) -> float:
        """0.0: not known yet. 1006h is exact but for drift: better for a while.

        What was learned stays until a reset, or a new lock knows better.
        """
        lock, nominal_s = self._chain.sample_grid, self._interval.nominal_s
        if lock.locked:
            learned_s = lock.period * TICK_S
            near = lock.seen < EXACT_SYNCS and abs(learned_s - nominal_s) <= CLOSE * nominal_s
            self._learned_s = nominal_s if near else learned_s
        return self._learned_s or nominal_s
