"""The speed of a lost position: by how many whole cycles per interval eq. 9 counts wrongly.

The truth is y + c + s t with y as eq. 9 counts it, and whole numbers c and s. An absolute sensor shows how
far the machine has really moved, with an error. Each pair of its values cuts the range of s,

    |ahead_j - ahead_i - s (t_j - t_i)| <= error_ij,

where ``ahead`` is its displacement less the counted one. One value may be false, by any d: beyond the error
E of a pair a neighbour gives s >= d - E, and a value t intervals away s <= (d + E) / t, so that nothing is
left once t >= 2 E + 1. The values that agree must span that long.
"""

from __future__ import annotations

import math

import numpy as np

MOST_VALUES = 512  # remembered; when there are more, every second one is forgotten, which only costs time
LEAST_VALUES = 3
PHASE_CYCLES = 0.05  # of the counted displacement: noise and an uncorrected phase at both ends


class SpeedSearch:
    """Finds the whole cycles per interval that the counted speed lacks.

    Two values differ from the truth by at most ``most_cycles``, or ``slope`` times the way between them,
    and ``noise_cycles``.
    """

    def __init__(self, slope: float, most_cycles: float, noise_cycles: float) -> None:
        self._slope, self._most_cycles = slope, most_cycles
        self._noise_cycles = noise_cycles + PHASE_CYCLES
        self._values = np.empty((3, MOST_VALUES))  # time, ahead, moved
        self.restart()

    def restart(self) -> None:
        """The next value is the first. Eq. 9 must count without a gap from there on."""
        self._known = 0
        self._first_time = 0.0
        self._seen = 0
        self._error = 0.0  # the largest of a pair, cycles
        self._low, self._high = -math.inf, math.inf

    def feed(self, time: float, ahead_cycles: float, moved_cycles: float) -> int | None:
        """The number, None as long as it is not certain. ``time`` in intervals; ``moved_cycles`` by the
        sensor since any instant, ``ahead_cycles`` that less the counted one.
        """
        known = self._known
        if known and time > self._values[0, known - 1]:
            times, ahead, moved = self._values[:, :known]
            apart = time - times
            error = (
                np.minimum(self._slope * np.abs(moved_cycles - moved), self._most_cycles) + self._noise_cycles
            )
            self._error = max(self._error, float(error.max()))
            self._low = max(self._low, float(((ahead_cycles - ahead - error) / apart).max()))
            self._high = min(self._high, float(((ahead_cycles - ahead + error) / apart).min()))
        self._remember(time, ahead_cycles, moved_cycles)
        if self._seen < LEAST_VALUES or not math.isfinite(self._high - self._low):
            return None
        least, most = math.ceil(self._low), math.floor(self._high)
        if least > most:
            self.restart()
            self._remember(time, ahead_cycles, moved_cycles)
        spans = time - self._first_time >= 2.0 * self._error + 1.0
        return least if least == most and spans else None

    def _remember(self, time: float, ahead_cycles: float, moved_cycles: float) -> None:
        if self._known == MOST_VALUES:
            self._values[:, : MOST_VALUES // 2] = self._values[:, ::2]
            self._known = MOST_VALUES // 2
        if not self._seen:
            self._first_time = time
        self._values[:, self._known] = time, ahead_cycles, moved_cycles
        self._known += 1
        self._seen += 1
