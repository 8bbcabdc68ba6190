"""When a SYNC really goes out: drift and jitter of its producer, and the frame on the bus before it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from canfb.checks import integer_in, number_in
from canfb.simulation.wire import LONGEST_FRAME_BITS

CUT_OFF = 4.0  # standard deviations
LARGEST_PART = 0.45  # of the period: SYNCs keep their order


@dataclass(frozen=True, kw_only=True)
class SyncTiming:
    """How far the SYNCs of a producer are from equidistant. Every field has a default: not at all.

    sync_jitter_us      of the producer, uniform within +-, 0..1e6 us
    sync_jitter_rms_us  of the producer, normal, cut off at 4 times that, 0..1e6 us; both add up
    sync_drift_ppm      how much faster than true time its clock runs, -10000..10000 ppm
    bus_load            part of the time at which the bus is busy with other frames, 0..1: the SYNC waits
                        for the end of the one on the wire, up to 135 bit times
    bus_bit_rate        bit/s of that bus, 10000..1000000

    ValueError for anything else.
    """

    sync_jitter_us: float = 0.0
    sync_jitter_rms_us: float = 0.0
    sync_drift_ppm: float = 0.0
    bus_load: float = 0.0
    bus_bit_rate: int = 1_000_000

    def __post_init__(self) -> None:
        number_in("sync_jitter_us", self.sync_jitter_us, 0.0, 1e6)
        number_in("sync_jitter_rms_us", self.sync_jitter_rms_us, 0.0, 1e6)
        number_in("sync_drift_ppm", self.sync_drift_ppm, -10_000.0, 10_000.0)
        number_in("bus_load", self.bus_load, 0.0, 1.0)
        integer_in("bus_bit_rate", self.bus_bit_rate, 10_000, 1_000_000)


REGULAR = SyncTiming()


class SyncDeviation:
    """Draws how far a SYNC is from its nominal time; the same ``seed`` gives the same SYNCs again.

    No SYNC is further off than 0.45 ``period_s``, so that they keep their order.
    """

    def __init__(self, timing: SyncTiming, period_s: float, seed: int = 1) -> None:
        self._timing = timing
        self._rng = np.random.default_rng((seed, 0x80))
        self._largest_s = LARGEST_PART * period_s
        self.period_s = period_s / (1.0 + timing.sync_drift_ppm * 1e-6)
        """The period in true time, seconds."""
        self._none = timing.sync_jitter_us == timing.sync_jitter_rms_us == timing.bus_load == 0.0

    def next_s(self) -> float:
        """Seconds by which the next SYNC goes out late (or, negative, early)."""
        if self._none:
            return 0.0
        timing, rng = self._timing, self._rng
        off_us = timing.sync_jitter_us * float(rng.uniform(-1.0, 1.0))
        off_us += timing.sync_jitter_rms_us * max(-CUT_OFF, min(CUT_OFF, float(rng.normal())))
        blocked = float(rng.uniform()) < timing.bus_load
        bits = LONGEST_FRAME_BITS * float(rng.uniform())
        off_s = off_us * 1e-6 + (bits / timing.bus_bit_rate if blocked else 0.0)
        return max(-self._largest_s, min(self._largest_s, off_s))
