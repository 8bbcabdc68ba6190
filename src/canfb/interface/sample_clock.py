"""The free-running clock of an encoder interface, which stamps its samples (2000:01)."""

from __future__ import annotations

import math

from canfb.signal.sample import TICKS

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
        """What it shows at the true time ``now``, seconds: 0..2^32 - 1, rounded down as a counter does."""
        return (self._start + math.floor(now * self._rate)) % TICKS
