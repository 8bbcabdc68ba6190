"""Samples of each SYNC from the scans of a converter that samples faster, by a clock of its own.

With n scans in an interval the newest sample is the n-th scan after that of the SYNC before, and the others
are n/m scans apart. Only the drift of the clock against SYNC moves this grid, by one scan.
"""

from __future__ import annotations

from collections import deque
from statistics import median

from canfb.signal.sample import TICKS, Sample
from canfb.sources.protocol import SourceError

LEAST_SCANS_PER_SYNC, MOST_SCANS_PER_SYNC = 2, 256
KEPT_INTERVALS = 3
LAGS = 32  # SYNCs over which the lag of the grid is watched: one that is late is no drift
SETTLE = 64.0  # scans over which their usual distance is followed
STEP = 0.5  # relative to it: a distance that differs by more is no distance of neighbours
KNOWN_BREAKS = 8
BLOCK_SYNCS, BLOCKS, LEAST_BLOCKS = 16, 16, 4  # in which scans are counted, to hold their number against
MOST_SCANS_OFF, PART_OFF = 1.5, 1.0 / 16.0  # of a block; and so much of an interval


class EvenScans:
    """Takes scans as they come, and gives ``per_sync`` of ``scans_per_sync`` for each SYNC."""

    def __init__(self, per_sync: int, scans_per_sync: int) -> None:
        self.per_sync = per_sync
        self._interval = scans_per_sync
        self._apart = scans_per_sync // per_sync
        self._lead = 1 + scans_per_sync // 16  # scans that are newer than the newest sample, at the start
        self._slack = min(2 + scans_per_sync // 16, scans_per_sync // 4)
        self.forget()

    def forget(self) -> None:
        self._scans: deque[Sample] = deque(maxlen=KEPT_INTERVALS * self._interval + self._lead)
        self._count = 0
        self._last: int | None = None  # the newest sample of the SYNC before, by the number of its scan
        self._lags: deque[int] = deque(maxlen=LAGS)
        self._syncs, self._block_began = 0, 0
        self._blocks: deque[int] = deque(maxlen=BLOCKS)  # scans that have come in this many SYNCs
        self._usual = 0.0  # 100 ns, from scan to scan
        self._breaks: deque[int] = deque(maxlen=KNOWN_BREAKS)  # scans before which others are missing
        self._misfit = ""

    def came(self, scan: Sample) -> None:
        if self._scans and scan.time_100ns is not None and self._scans[-1].time_100ns is not None:
            self._follow((scan.time_100ns - self._scans[-1].time_100ns) % TICKS)
        self._scans.append(scan)
        self._count += 1

    def _follow(self, distance: int) -> None:
        usual = self._usual or float(distance)
        low, high = (1.0 - STEP) * usual, (1.0 + STEP) * usual
        if not low < distance < high:
            self._breaks.append(self._count)
        self._usual = usual + (min(max(distance, low), high) - usual) / SETTLE

    def take(self) -> Sample | None:
        """The samples of this SYNC; None: too few scans. SourceError for missing ones, or a wrong number of
        them.
        """
        self._count_sync()
        newest = self._begin() if self._last is None else self._next(self._last)
        if newest is None:
            return None
        self._last = newest
        first = newest - (self.per_sync - 1) * self._apart
        if self._misfit:
            raise SourceError(self._misfit)
        if any(first < one <= newest for one in self._breaks):
            raise SourceError("scans are missing: the buffer has overrun, or the trigger came late")
        chosen = [self._scans[number - self._count] for number in range(newest, first - 1, -self._apart)]
        earlier = tuple((one.sine, one.cosine) for one in chosen[1:])
        return chosen[0]._replace(earlier=earlier)

    def _begin(self) -> int | None:
        newest = self._count - 1 - self._lead
        return newest if newest >= self._interval else None

    def _next(self, last: int) -> int | None:
        interval, latest = self._interval, self._count - 1
        newest = last + interval
        lag = latest - newest
        if lag >= interval:  # SYNCs that were missed
            newest += lag // interval * interval
            lag %= interval
        if 2 * lag < -interval:
            return None
        if lag < 0:
            newest, lag = self._moved(newest, lag), 0
        elif len(self._lags) == LAGS and min(self._lags) > self._slack:
            newest, lag = self._moved(newest, 1), lag - 1
        self._lags.append(lag)
        return newest

    def _moved(self, newest: int, scans: int) -> int:
        self._lags = deque((lag - scans for lag in self._lags), maxlen=LAGS)
        return newest + scans

    def _count_sync(self) -> None:
        """Hold the scans that come against those that should; blocks with a late or a lost SYNC are few."""
        self._syncs += 1
        if self._syncs % BLOCK_SYNCS:
            return
        if self._last is not None:
            self._blocks.append(self._count - self._block_began)
        self._block_began = self._count
        if len(self._blocks) >= LEAST_BLOCKS:
            scans, interval = median(self._blocks), self._interval
            fits = abs(scans - BLOCK_SYNCS * interval) <= MOST_SCANS_OFF + PART_OFF * interval
            real = scans / BLOCK_SYNCS
            self._misfit = (
                ""
                if fits
                else f"scans_per_sync is {interval}, but {real:.3g} come with each SYNC; see rate_hz"
            )


class NewestScan:
    """Gives the newest scan that no SYNC has taken."""

    per_sync = 1

    def __init__(self) -> None:
        self._scan: Sample | None = None

    def came(self, scan: Sample) -> None:
        self._scan = scan

    def forget(self) -> None:
        self._scan = None

    def take(self) -> Sample | None:
        scan, self._scan = self._scan, None
        return scan
