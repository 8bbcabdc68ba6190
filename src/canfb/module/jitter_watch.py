"""Without sample times the jitter of SYNC limits the speed: says so before the position is lost."""

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

PEAK = 2.5  # times the mean deviation of SYNC: 2 for a uniform one, 3 standard deviations are 3.8
NEAR, AWAY = 0.7, 0.5  # of the largest speed: where the warning comes, and where it may come again
SHORTEST_S = 10.0  # from one warning to the next
EXAMPLES_US = (10, 100)


class JitterWatch:
    """Compares the speed with what 4 v j < L - a allows for the measured jitter j (docs/time.md).

    Without receive times nothing is said. ``warn`` gets one line.
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
        """Peak deviation of a SYNC from its lock, seconds."""
        return PEAK * self._syncs.grid.deviation

    @property
    def max_speed_rad_s(self) -> float:
        """The largest speed for this jitter, rad/s; inf without, or with several samples a SYNC."""
        limits = self.jitter_s > 0.0 and self._interval.samples_per_sync == 1
        return self._max_speed(self.jitter_s) if limits else math.inf

    def _max_speed(self, jitter_s: float) -> float:
        limits = self._limits.in_force
        most = 4.0 * limits.phase_error if limits.acceleration_waits else 0.5  # left at any interval
        left = min(most, limits.residual_limit - (limits.acceleration or 0.0))
        return max_speed(self._cycles_per_revolution.value, jitter_s, left) if left > 0.0 else 0.0

    def in_words(self) -> str:
        speeds = (f"{self._max_speed(us * 1e-6) * RPM:.3g} rpm at ±{us} µs" for us in EXAMPLES_US)
        return f"without sample times the jitter of SYNC limits the speed: {', '.join(speeds)}"

    def look(self, last: Feedback, now: float) -> None:
        """After ``last``, not with each sample; ``now`` in seconds."""
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
