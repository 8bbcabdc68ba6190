"""The residual limit of a module that is in force, by its objects (2010h) and the SYNC on the bus."""

from __future__ import annotations

import math
from dataclasses import dataclass

from canfb.signal.limits import PHASE_ERROR_CYCLES, limit_narrowed_by_jerk, narrowed_residual_limit
from canfb.signal.sample_times import TICK_S
from canfb.signal.third_order import THIRD


@dataclass(frozen=True)
class LimitSettings:
    """What the limit depends on; 0 for what is not set, or not known.

    widest_cycles          2010:01
    prediction_order       2010:07
    acceleration_rad_s2, jerk_rad_s3   2010:02 and 2010:08
    noise_margin           2010:09
    phase_error_cycles     2010:0C
    cycle_period_s         1006h
    samples_per_sync       pairs that its RPDOs carry
    timed                  they carry the sample time
    """

    widest_cycles: float = 0.5
    prediction_order: int = 2
    acceleration_rad_s2: float = 0.0
    jerk_rad_s3: float = 0.0
    noise_margin: int = 0
    phase_error_cycles: float = PHASE_ERROR_CYCLES
    cycle_period_s: float = 0.0
    samples_per_sync: int = 1
    timed: bool = False

    def limit_cycles(
        self,
        cycles_per_revolution: int,
        sync_hz: float | None,
        noise_cycles: float | None = None,
        velocity_rad_s: float | None = None,
    ) -> float:
        """The limit in force; 2010:01 where nothing narrows it, or the interval is not known.

        ``sync_hz`` is as measured, None: as 1006h has it. ``noise_cycles`` is 2011:0B, None: not read; the
        module takes the largest of its last blocks, so its limit may be a little wider.
        """
        sync_s = 1.0 / sync_hz if sync_hz else self.cycle_period_s
        interval_s = sync_s / self.samples_per_sync
        if not interval_s:
            return self.widest_cycles
        margin = self.noise_margin * noise_cycles if self.noise_margin and noise_cycles else math.inf
        third = self.prediction_order == THIRD
        narrowed, known = (
            (limit_narrowed_by_jerk, self.jerk_rad_s3)
            if third
            else (narrowed_residual_limit, self.acceleration_rad_s2)
        )
        limit = narrowed(
            self.widest_cycles, known, cycles_per_revolution, interval_s, margin, self.phase_error_cycles
        )
        if self.timed and velocity_rad_s:
            cycles_per_s = abs(velocity_rad_s) * cycles_per_revolution / (2.0 * math.pi)
            limit += (8.0 if third else 4.0) * cycles_per_s * (TICK_S / 2.0)  # all phases off by half a tick
        return min(limit, self.widest_cycles)


NOTHING_NARROWS = LimitSettings()
