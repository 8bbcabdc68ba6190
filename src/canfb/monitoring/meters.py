"""What is measured of the bus as a whole: SYNC and load; and a history of peaks. Times are seconds."""

from __future__ import annotations

import math
import statistics
from collections import deque
from collections.abc import Sequence
from itertools import pairwise

from canfb.monitoring.snapshot import LoadSnapshot, SyncSnapshot

SYNCS = 512  # that are looked at
LEAST_SYNCS = 4
OLDEST_S = 2.0
MISSING_PERIODS = 8.0  # without a SYNC: there is none
LEAST_SILENCE_S = 0.1
SHORTEST_S = 1e-6  # a SYNC takes longer on any bus
SAME = 0.1  # of a period: a doubled SYNC
SLOT_S = 0.1
SLOTS = 10


class SyncMeter:
    """Rate and jitter by the straight line through the times of the last SYNCs, gaps left out."""

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=SYNCS)
        self._count = 0

    def sync(self, time_s: float) -> None:
        """A SYNC came."""
        self._times.append(time_s)
        self._count += 1

    def snapshot(self, now: float) -> SyncSnapshot:
        """Rate and jitter by ``now``."""
        if not self._times:
            return SyncSnapshot()
        silent_s = max(0.0, now - self._times[-1])
        times = [time for time in self._times if now - time <= OLDEST_S] or [*self._times][-LEAST_SYNCS:]
        line = _line(times)
        if line is None or silent_s > max(LEAST_SILENCE_S, MISSING_PERIODS * line[0]):
            return SyncSnapshot(silent_s=silent_s, count=self._count)
        period_s, errors = line
        rms = math.sqrt(sum(error * error for error in errors) / len(errors))
        return SyncSnapshot(1.0 / period_s, rms, max(map(abs, errors)), silent_s, self._count)


def _line(times: Sequence[float]) -> tuple[float, list[float]] | None:
    """The period, and the deviation of each time from the regular grid (least squares); None for too few."""
    steps = [after - before for before, after in pairwise(times)]
    if len(times) < LEAST_SYNCS or (middle := statistics.median(steps)) < SHORTEST_S:
        return None
    places, kept = [0], [times[0]]
    for step, time in zip(steps, times[1:], strict=True):
        if step > SAME * middle:
            places.append(places[-1] + max(1, round((time - kept[-1]) / middle)))
            kept.append(time)
    if len(kept) < LEAST_SYNCS:
        return None
    mean_place, mean_time = statistics.fmean(places), statistics.fmean(kept)
    spread = sum((place - mean_place) ** 2 for place in places)
    period = sum((p - mean_place) * (t - mean_time) for p, t in zip(places, kept, strict=True)) / spread
    if not SHORTEST_S <= period < math.inf:
        return None
    return period, [t - mean_time - period * (p - mean_place) for p, t in zip(places, kept, strict=True)]


class LoadMeter:
    """Bits and frames of the last second, in slots of a tenth."""

    def __init__(self, bit_rate: int | None = None) -> None:
        self.bit_rate = bit_rate
        self._slots: deque[list[int]] = deque(maxlen=SLOTS + 1)  # number, bits, frames
        self._first: int | None = None

    def frame(self, bits: int, now: float) -> None:
        """A frame with so many bits on the wire."""
        slot = math.floor(now / SLOT_S)
        if self._first is None:
            self._first = slot
        if not self._slots or self._slots[-1][0] < slot:
            self._slots.append([slot, 0, 0])
        self._slots[-1][1] += bits
        self._slots[-1][2] += 1

    def snapshot(self, now: float) -> LoadSnapshot:
        """Of the slots that are over by ``now``."""
        present = math.floor(now / SLOT_S)
        passed = 0 if self._first is None else min(SLOTS, present - self._first)
        if passed <= 0:
            return LoadSnapshot(bit_rate=self.bit_rate, load=0.0 if self.bit_rate else None)
        over = [slot for slot in self._slots if present - passed <= slot[0] < present]
        bits, frames = (sum(slot[n] for slot in over) / (passed * SLOT_S) for n in (1, 2))
        return LoadSnapshot(frames, bits, self.bit_rate, bits / self.bit_rate if self.bit_rate else None)


class PeakHistory:
    """The peak of each interval of ``bin_s`` seconds, of the last ``bins`` intervals."""

    def __init__(self, bin_s: float, bins: int) -> None:
        self.bin_s = bin_s
        self._bins = bins
        self._peaks: deque[tuple[int, float]] = deque(maxlen=bins)

    def add(self, value: float, now: float) -> None:
        """A value at this time."""
        number = math.floor(now / self.bin_s)
        if self._peaks and self._peaks[-1][0] >= number:
            last, peak = self._peaks[-1]
            self._peaks[-1] = last, max(peak, value)
        else:
            self._peaks.append((number, value))

    def values(self, now: float) -> list[float | None]:
        """From the first interval that is remembered to that of ``now``; None where there was no value."""
        if not self._peaks:
            return []
        last = math.floor(now / self.bin_s)
        known = dict(self._peaks)
        first = max(self._peaks[0][0], last - self._bins + 1)
        return [known.get(number) for number in range(first, last + 1)]

    def peak(self, now: float, seconds: float) -> float | None:
        """The largest of the last ``seconds``, as far as intervals allow."""
        oldest = math.floor((now - seconds) / self.bin_s)
        return max((peak for number, peak in self._peaks if number >= oldest), default=None)
