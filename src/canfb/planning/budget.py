"""What uses up the residual limit of a module (eq. 12), and the limits of the motion that follow.

The residual of a healthy machine is at most

    a N/(2 pi) T^2  +  4 v u  +  4 e  +  noise

with acceleration a, speed v, error e of a phase, interval T from sample to sample, and the uncertainty u of
the sampling instant: without sample times half the range of the SYNC, with them half a unit of the sample
time. Errors of a phase add up to the largest, their squares to the rms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

from canfb.planning.plan_input import PlanInput
from canfb.planning.planned_module import PlannedModule
from canfb.signal.declared import Declared
from canfb.signal.limits import (
    cycles_per_interval_squared,
    max_acceleration,
    max_speed,
)
from canfb.signal.sample import TICK_S

RAW_PHASE_ERROR_CYCLES = 0.0113  # of Table 1, without a correction table
TABLE_PHASE_ERROR_CYCLES = 0.001  # of what a reference measurement leaves
PEAK = 6.0  # standard deviations of the noise: one healthy sample in 5e8 is further off
ROUNDING_VARIANCE = 1.0 / 12.0  # counts^2
RPM = 60.0 / (2.0 * math.pi)  # of a speed in rad/s


WEIGHTS, SQUARES = 4.0, 6.0  # sums of the sizes and of the squares of 1, 2, 1 (eq. 9)


HALF_TICK_S = TICK_S / 2.0  # a sample time is rounded down
ROUNDING, ROUNDING_CYCLES = 1e-6, 1e-9  # of sums: a limit that is narrowed to the motion holds


@dataclass(frozen=True)
class ResidualBudget:
    """One module under the motion of the plan. What is not given counts as 0."""

    plan_input: PlanInput
    module: PlannedModule

    @property
    def interval_s(self) -> float:
        return 1.0 / self.sample_hz

    @property
    def sample_hz(self) -> float:
        return self.plan_input.sync_hz * self.module.samples_per_sync

    @cached_property
    def limit_cycles(self) -> float:
        """In force at the given speed: uncertain sample times widen a narrowed one."""
        uncertain = WEIGHTS * self._cycles_per_s * self.known_uncertainty_s
        return min(self.slow_limit_cycles + uncertain, self.module.widest_limit_cycles)

    @cached_property
    def slow_limit_cycles(self) -> float:
        return self.bounds.residual_limit

    @cached_property
    def bounds(self) -> Declared:
        return self.module.bounds(self.interval_s, self.measured_noise_cycles)

    @cached_property
    def declared(self) -> Declared:
        return replace(self.bounds, coast_samples=self.module.coast_samples)

    @property
    def is_narrowed(self) -> bool:
        return self.slow_limit_cycles < self.module.widest_limit_cycles

    @cached_property
    def measured_noise_cycles(self) -> float:
        """Rms of the residual without motion (2011:0B)."""
        return math.sqrt(SQUARES) * math.hypot(
            self.phase_noise_cycles, self.phase_error_cycles / math.sqrt(3.0)
        )

    @cached_property
    def noise_margin_cycles(self) -> float:
        return self.module.settings.noise_margin * self.measured_noise_cycles or math.inf

    @property
    def has_noise_margin(self) -> bool:
        return self.is_narrowed and self.noise_margin_cycles < self._declared_cycles

    @property
    def asked_rad_s2(self) -> float | None:
        return self.plan_input.acceleration_of(self.module)

    @cached_property
    def sync_jitter_s(self) -> float:
        """Half its range: of the producer and of frames before it; or 2010:0D."""
        return max(
            self.plan_input.jitter_s + self.plan_input.bus.sync_delay_s / 2.0, self.module.declared_jitter_s
        )

    @cached_property
    def uncertainty_s(self) -> float:
        """Of the sampling instant, half its range; 0.0 for a module that samples itself."""
        if self.module.samples_itself:
            return 0.0
        jitter_s = 0.0 if self.module.samples_per_sync > 1 else self.sync_jitter_s
        return (self.known_uncertainty_s if self.module.times else jitter_s) + self.plan_input.aperture_s

    @property
    def known_uncertainty_s(self) -> float:
        """Resolution of sample times, which the module adds to its limit."""
        return HALF_TICK_S if self.module.times and not self.module.samples_itself else 0.0

    @property
    def parts_cycles(self) -> dict[str, float]:
        instants = self.instants_cycles
        return {
            "acceleration": self.motion_cycles,
            "sampling instants": instants,
            "errors of the encoder": self.rest_cycles(instants) - instants,
        }

    @cached_property
    def motion_cycles(self) -> float:
        return self.acceleration_cycles(self.asked_rad_s2 or 0.0)

    @cached_property
    def needed_cycles(self) -> float:
        return sum(self.parts_cycles.values())

    @property
    def margin(self) -> float:
        return over(self.limit_cycles, self.needed_cycles)

    @property
    def equation_rad_s2(self) -> float:
        """Eq. 12 without any errors."""
        return self._acceleration(self.limit_cycles, self.sample_hz)

    @property
    def paper_rad_s2(self) -> float:
        """Eq. 10."""
        return max_acceleration(self.module.cycles_per_revolution, self.sample_hz)

    @property
    def largest_acceleration_rad_s2(self) -> float:
        """With the speed as given, unless that alone is too much; 0.0 if the errors need the whole limit."""
        return self._acceleration(self.left_in_force_cycles, 1.0 / self.worst_interval_s)

    @property
    def equation_speed_rad_s(self) -> float:
        """w v u < L without any errors; inf without an uncertainty."""
        return self._speed_beside(0.0)

    @property
    def largest_speed_rad_s(self) -> float:
        """With the acceleration as given, unless that alone is too much.

        0.0 if the errors need the whole limit, inf if the sampling instants are known.
        """
        motion = self.motion_cycles
        if self.slow_limit_cycles - motion < self.rest_cycles(0.0) - ROUNDING_CYCLES:
            motion = 0.0
        return self._speed_beside(motion + self.phase_cycles)

    def _speed_beside(self, needed_cycles: float) -> float:
        own_s = self.uncertainty_s - self.known_uncertainty_s
        return min(
            self.speed_rad_s(self.slow_limit_cycles - needed_cycles, own_s),
            self.speed_rad_s(self.module.widest_limit_cycles - needed_cycles, self.uncertainty_s),
        )

    @property
    def least_sync_hz(self) -> float:
        """The SYNC rate below which the motion takes too much; inf if no rate is enough.

        With 2010:01: a limit that is narrowed follows the rate. A speed that is too high alone does not
        count.
        """
        widest = self.module.widest_limit_cycles
        taken, left = self.motion_cycles, self.left_cycles(widest, widest)
        if not taken:
            return 0.0
        return self.plan_input.sync_hz * math.sqrt(taken / left) if left > 0.0 else math.inf

    @cached_property
    def off_s(self) -> float:
        """How far samples may be from equal intervals, +-, if their times are known.

        0.0 without sample times: they count as equal then, and as an error of the position.
        """
        by_sync = self.module.samples_per_sync == 1 and not self.module.samples_itself
        return self.sync_jitter_s if self.module.times and by_sync else 0.0

    @property
    def worst_interval_s(self) -> float:
        """Equal intervals that leave as much of eq. 9 as unequal ones at worst: a h (g + h)/2."""
        return math.sqrt((self.interval_s + 2.0 * self.off_s) * (self.interval_s + self.off_s))

    def acceleration_cycles(self, acceleration_rad_s2: float) -> float:
        return cycles_per_interval_squared(
            acceleration_rad_s2, self.module.cycles_per_revolution, self.worst_interval_s
        )

    @cached_property
    def phase_noise_cycles(self) -> float:
        """The rms noise of a phase; inf without an amplitude."""
        counts = math.sqrt(self.plan_input.noise_counts**2 + ROUNDING_VARIANCE)
        amplitude = self.plan_input.amplitude * self.module.full_scale_counts
        return counts / (2.0 * math.pi * amplitude) if amplitude else math.inf

    @property
    def phase_error_cycles(self) -> float:
        """Without noise, given or usual."""
        if self.plan_input.phase_cycles is not None:
            return self.plan_input.phase_cycles
        return TABLE_PHASE_ERROR_CYCLES if self.module.has_table else RAW_PHASE_ERROR_CYCLES

    @property
    def phase_cycles(self) -> float:
        """Errors of the phases in a residual: all at the same time, or six deviations of the noise."""
        largest = WEIGHTS * self.phase_error_cycles + PEAK * math.sqrt(SQUARES) * self.phase_noise_cycles
        return min(largest, PEAK * self.measured_noise_cycles) if self.has_noise_margin else largest

    @property
    def _cycles_per_s(self) -> float:
        cycles = self.module.cycles_per_revolution
        return (self.plan_input.speed_rad_s or 0.0) * cycles / (2 * math.pi)

    @property
    def instants_cycles(self) -> float:
        """Of the sampling instants in a residual."""
        return WEIGHTS * self._cycles_per_s * self.uncertainty_s

    def rest_cycles(self, instants_cycles: float) -> float:
        """All but the motion; without a table 4 x 2010:0C at least."""
        uncorrected = self.plan_input.phase_cycles is None and not self.module.has_table
        rest = self.phase_cycles + instants_cycles
        return max(rest, self._declared_cycles) if uncorrected else rest

    @property
    def _declared_cycles(self) -> float:
        return WEIGHTS * self.module.settings.phase_error_cycles

    @property
    def left_in_force_cycles(self) -> float:
        return self.left_cycles(self.limit_cycles, self.slow_limit_cycles)

    def left_cycles(self, limit_cycles: float, slow_limit_cycles: float) -> float:
        """What a limit, and that of a slow machine, leave; without the speed if that is too much."""
        left = limit_cycles - self.rest_cycles(self.instants_cycles)
        return left if left > 0.0 else slow_limit_cycles - self.rest_cycles(0.0)

    def speed_rad_s(self, left_cycles: float, uncertainty_s: float) -> float:
        """At which the instants need so much; inf if they are known."""
        if left_cycles <= 0.0:
            return 0.0
        if uncertainty_s <= 0.0:
            return math.inf
        return max_speed(self.module.cycles_per_revolution, uncertainty_s, min(left_cycles, 0.5))

    def _acceleration(self, left_cycles: float, rate_hz: float) -> float:
        cycles = self.module.cycles_per_revolution
        return max_acceleration(cycles, rate_hz, min(left_cycles, 0.5)) if left_cycles > 0.0 else 0.0


def over(limit: float, value: float) -> float:
    """The margin of a limit as a factor; inf if nothing is asked, or nothing limits."""
    if value == 0.0 or math.isinf(limit):
        return math.inf
    factor = limit / value
    return 1.0 if math.isclose(factor, 1.0, rel_tol=ROUNDING) else factor
