"""The limits of the motion in force, by 2010h and the SYNC rate."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from canfb import objects as od
from canfb.signal.declared import DOUBT_ACCELERATION, Declared
from canfb.signal.harmonics import NO_LOW_PASS, Corners
from canfb.signal.limits import (
    PHASE_ERROR_CYCLES,
    cycles_per_interval_squared,
    narrowed_residual_limit,
)
from canfb.signal.residual_noise import RESIDUAL_WEIGHTS
from canfb.signal.sample import TICK_S
from canfb.view.pdo_map import Read, valid_pdos

LIMIT_UNITS = 65536  # 2010:01 and 2011:02 count in 1/65536 cycle


@dataclass(frozen=True)
class LimitSettings:
    """What the limit depends on; 0: not set, or not known.

    widest_cycles      2010:01
    doubt_acceleration 2010:0B, cycles per interval^2
    cycle_period_s     1006h
    timed              RPDOs carry the sample time
    """

    widest_cycles: float = 0.5
    acceleration_rad_s2: float = 0.0
    noise_margin: int = 0
    bad_samples: int = 0
    doubt_acceleration: float = DOUBT_ACCELERATION
    phase_error_cycles: float = PHASE_ERROR_CYCLES
    cycle_period_s: float = 0.0
    samples_per_sync: int = 1
    timed: bool = False
    corners: Corners = NO_LOW_PASS

    def limit_cycles(
        self,
        cycles_per_revolution: int,
        sync_hz: float | None,
        noise_cycles: float | None = None,
        velocity_rad_s: float | None = None,
    ) -> float:
        """The limit in force; 2010:01 where nothing narrows it or no interval is known.

        ``sync_hz`` None: by 1006h. ``noise_cycles`` is 2011:0B, None: not read.
        """
        sync_s = 1.0 / sync_hz if sync_hz else self.cycle_period_s
        interval_s = sync_s / self.samples_per_sync
        limit = self.bounds(cycles_per_revolution, interval_s, noise_cycles).residual_limit
        if not interval_s:
            return limit
        if self.timed and velocity_rad_s:
            cycles_per_s = abs(velocity_rad_s) * cycles_per_revolution / (2.0 * math.pi)
            limit += 4.0 * cycles_per_s * (TICK_S / 2.0)  # all phases off by half a tick
        return min(limit, self.widest_cycles)

    def needed_cycles(self, cycles_per_revolution: int, sync_hz: float) -> float:
        """The least 2010:01 that good samples keep, by 2010:02 and 2010:0C (0 Hz: 2010:0C)."""
        interval_s = 1.0 / (sync_hz * self.samples_per_sync) if sync_hz else 0.0
        expected = cycles_per_interval_squared(self.acceleration_rad_s2, cycles_per_revolution, interval_s)
        return expected + 4.0 * self.phase_error_cycles

    def bounds(
        self, cycles_per_revolution: int, interval_s: float, noise_cycles: float | None = None
    ) -> Declared:
        """At this interval from sample to sample; 0.0: not known."""
        n, widest = cycles_per_revolution, self.widest_cycles
        margin = math.inf
        if self.noise_margin and noise_cycles is not None:
            margin = self.noise_margin * noise_cycles
        declared = self.phase_error_cycles
        phase_error = min(declared, margin / math.sqrt(RESIDUAL_WEIGHTS))
        known = Declared(
            residual_limit=widest,
            widest_limit=widest,
            acceleration_waits=not interval_s and self.acceleration_rad_s2 > 0.0,
            phase_error=phase_error,
            bad=self.bad_samples,
            doubt_acceleration=self.doubt_acceleration,
        )
        if not interval_s:
            return known
        return replace(
            known,
            residual_limit=narrowed_residual_limit(
                widest, self.acceleration_rad_s2, n, interval_s, margin, declared
            ),
            acceleration=cycles_per_interval_squared(self.acceleration_rad_s2, n, interval_s) or None,
            instant_error=TICK_S / 2.0 / interval_s if self.timed else 0.0,
        )


def limit_settings(read: Read) -> LimitSettings:
    mapped = [pdo.entries for pdo in valid_pdos(read, od.RPDO, od.RPDO_MAPPING)]
    residual = read(od.SUPERVISION_RESIDUAL_LIMIT)
    return LimitSettings(
        widest_cycles=0.5 if residual is None else residual / LIMIT_UNITS,
        acceleration_rad_s2=float(read(od.SUPERVISION_ACCELERATION) or 0.0),
        noise_margin=int(read(od.SUPERVISION_NOISE_MARGIN) or 0),
        bad_samples=int(read(od.SUPERVISION_BAD_SAMPLES) or 0),
        doubt_acceleration=_in_cycles(read(od.SUPERVISION_DOUBT_ACCELERATION), DOUBT_ACCELERATION),
        phase_error_cycles=_in_cycles(read(od.SUPERVISION_PHASE_ERROR), PHASE_ERROR_CYCLES),
        cycle_period_s=int(read(od.CYCLE_PERIOD) or 0) * 1e-6,
        samples_per_sync=od.samples_per_sync(mapped),
        timed=any(od.SAMPLE_TIME.mapped(32) in one for one in mapped),
        corners=Corners(
            float(read(od.ENCODER_CORNER_FREQUENCY) or 0.0),
            float(read(od.ENCODER_COSINE_CORNER_FREQUENCY) or 0.0),
        ),
    )


def _in_cycles(value: float | None, default: float) -> float:
    return default if value is None else value / LIMIT_UNITS


NOTHING_NARROWS = LimitSettings()
