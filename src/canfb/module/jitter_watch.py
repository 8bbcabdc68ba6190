"""Warns, before the position is lost, that the jitter of SYNC limits the speed without sample times."""

from __future__ import annotations

import math
from collections.abc import Callable

from canfb.device.od.dictionary import Entry
from canfb.module.interval import SamplingInterval
from canfb.module.parameters import Limits
from canfb.signal.limits import RPM, max_speed
from canfb.signal.sample import Feedback
from canfb.signal.supervision import VALID
from canfb.timing.syncs import Syncs

PEAK = 2.5  # peak over mean deviation of SYNC: 2 for a uniform distribution, 3.8 for 3 standard deviations
NEAR, AWAY = 0.7, 0.5  # parts of the largest speed: above NEAR a warning, below AWAY it is armed again
SHORTEST_S = 10.0  # time from one warning to the next
EXAMPLES_US = (10, 100)
LEAST_JITTER_S = 1e-8  # less is rounding: no clock of a bus is as fine


class JitterWatch:
    """Compares the speed v with the limit 4 v j < L - a for the measured jitter j (docs/time.md).

    Not without receive times. ``warn`` gets one line.
    """

    def __init__(
        self,
        syncs: Syncs,
        interval: SamplingInterval,
        limits: Limits,
        cycles_per_revolution: Entry,
        warn: Callable[[str], None],
    ) -> None:
        self._syncs, self._interval, self._limits = syncs, interval, limits
        self._cycles_per_revolution = cycles_per_revolution
        self._warn = warn
        self._near = False
        self._not_before_s = -math.inf

    @property
    def jitter_s(self) -> float:
        """Peak deviation of a SYNC from its grid, seconds."""
        return PEAK * self._syncs.grid.deviation

    @property
    def max_speed_rad_s(self) -> float:
        """The largest speed for the measured jitter, rad/s; inf without, or with several samples per SYNC."""
        limits = self.jitter_s > LEAST_JITTER_S and self._interval.samples_per_sync == 1
        return self._max_speed(self.jitter_s) if limits else math.inf

    def _max_speed(self, jitter_s: float) -> float:
        limits = self._limits.in_force
        most = 4.0 * limits.phase_error if limits.acceleration_waits else 0.5  # margin for any interval
        left = min(most, limits.residual_limit - (limits.acceleration or 0.0))
        return max_speed(self._cycles_per_revolution.value, jitter_s, left) if left > 0.0 else 0.0

    def in_words(self) -> str:
        speeds = (f"{self._max_speed(us * 1e-6) * RPM:.3g} rpm at ±{us} µs" for us in EXAMPLES_US)
        return f"without sample times the jitter of SYNC limits the speed: {', '.join(speeds)}"

    def look(self, last: Feedback, now: float) -> None:
        """Check the speed of ``last``, at ``now`` in seconds; not needed for each sample."""
        interval_s = self._syncs.grid.period / self._interval.samples_per_sync
        if not interval_s or not last.status & VALID:
            return
        rad_per_cycle = 2.0 * math.pi / self._cycles_per_revolution.value
        speed, largest = abs(last.speed_cycles) / interval_s * rad_per_cycle, self.max_speed_rad_s
        if speed < AWAY * largest:
            self._near = False
        elif speed > NEAR * largest and not self._near and now >= self._not_before_s:
            self._near, self._not_before_s = True, now + SHORTEST_S
            self._warn(
                f"the SYNC jitter of ±{self.jitter_s * 1e6:.0f} µs allows at most {largest * RPM:.3g} rpm "
                f"without sample times; the encoder turns at {speed * RPM:.3g} rpm "
                "(remedy: times: true)"
            )
