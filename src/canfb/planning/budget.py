"""What uses up the residual limit of a module (eq. 12), and the limits of the motion that follow.

The residual of a healthy machine is at most

    a N/(2 pi) T^2  +  4 v u  +  4 e  +  noise

with the acceleration a, the speed v, the error e of a phase and the uncertainty u of the sampling instant:
without sample times half the range of the SYNC, with them half a unit of the sample time. Unequal intervals
T, which sample times allow, make the first part larger.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

from canfb.planning.planned_module import PlannedModule
from canfb.planning.situation import Situation
from canfb.signal.limits import (
    PHASE_ERROR_MARGIN_CYCLES,
    cycles_per_interval_squared,
    max_acceleration,
    max_speed,
)

HALF_TICK_S = 50e-9  # a sample time is rounded down to 100 ns
WEIGHT = 4.0  # of eq. 9: three phases with 1, 2, 1
RAW_PHASE_ERROR_CYCLES = 0.0113  # of Table 1, without a correction table
TABLE_PHASE_ERROR_CYCLES = 0.001  # of what a reference measurement leaves
PEAK = 6.0  # standard deviations of the noise: one healthy sample in 5e8 is further off
ROUNDING_VARIANCE = 1.0 / 12.0  # counts^2
ROUNDING, ROUNDING_CYCLES = 1e-6, 1e-9  # of sums: a limit that is narrowed to the motion holds


@dataclass(frozen=True)
class ResidualPart:
    """A part of the largest residual."""

    what: str
    cycles: float


@dataclass(frozen=True)
class ResidualBudget:
    """One module under the motion of the situation. What is not stated counts as nothing."""

    situation: Situation
    module: PlannedModule

    @property
    def interval_s(self) -> float:
        """The nominal sampling interval."""
        return 1.0 / self.situation.sync_hz

    @cached_property
    def limit_cycles(self) -> float:
        """The residual limit in force."""
        return self.module.residual_limit_cycles(self.interval_s)

    @property
    def asked_rad_s2(self) -> float | None:
        """The largest acceleration that the module has to follow; None: not stated."""
        return self.situation.motion.acceleration_of(self.module)

    @cached_property
    def sync_jitter_s(self) -> float:
        """Half the range of the SYNC on the bus: that of its producer, and of the frames before it."""
        return self.situation.jitter_s + self.situation.bus.sync_delay_s / 2.0

    @cached_property
    def uncertainty_s(self) -> float:
        """Half the range in which the sampling instant may be; 0.0 for a module that samples itself."""
        if self.module.samples_itself:
            return 0.0
        return (HALF_TICK_S if self.module.times else self.sync_jitter_s) + self.situation.aperture_s

    @property
    def parts(self) -> tuple[ResidualPart, ...]:
        """What the residual is made of, at worst, all at the same time."""
        instants = self._instants_cycles
        return (
            ResidualPart("acceleration", self._taken_cycles),
            ResidualPart("sampling instants", instants),
            ResidualPart("errors of the encoder", self._rest_cycles(instants) - instants),
        )

    @cached_property
    def needed_cycles(self) -> float:
        """The largest residual of the healthy machine; the limit has to be above it."""
        return sum(part.cycles for part in self.parts)

    @property
    def margin(self) -> float:
        """Residual limit over what is needed."""
        return over(self.limit_cycles, self.needed_cycles)

    @cached_property
    def noise_cycles(self) -> float:
        """The noise of the tracks in the residual, at most."""
        errors = self.situation.errors
        counts = math.sqrt(errors.noise_counts**2 + ROUNDING_VARIANCE)
        amplitude = errors.amplitude * self.module.full_scale_counts
        if not amplitude:
            return math.inf
        return PEAK * math.sqrt(WEIGHT + 2.0) * counts / (2.0 * math.pi * amplitude)

    @property
    def phase_cycles(self) -> float:
        """Errors of the phases in the residual, without those of their instants."""
        stated = self.situation.errors.phase_cycles
        if stated is None:
            stated = TABLE_PHASE_ERROR_CYCLES if self.module.has_table else RAW_PHASE_ERROR_CYCLES
        return WEIGHT * stated + self.noise_cycles

    @property
    def equation_rad_s2(self) -> float:
        """The acceleration that eq. 12 allows without any errors."""
        return self._acceleration(self.limit_cycles, self.situation.sync_hz)

    @property
    def paper_rad_s2(self) -> float:
        """The acceleration that eq. 10 allows."""
        return max_acceleration(self.module.cycles_per_revolution, self.situation.sync_hz)

    @property
    def largest_acceleration_rad_s2(self) -> float:
        """With the speed as stated, unless that alone is too much; 0.0 if the errors need the whole limit."""
        left = self.limit_cycles - self._rest_cycles(self._instants_cycles)
        if left <= 0.0:
            left = self.limit_cycles - self._rest_cycles(0.0)
        return self._acceleration(left, 1.0 / self.worst_interval_s)

    @property
    def equation_speed_rad_s(self) -> float:
        """The speed that 4 v u < L allows without any errors; inf without an uncertainty."""
        return self._speed(self.limit_cycles)

    @property
    def largest_speed_rad_s(self) -> float:
        """With the acceleration as stated, unless that alone is too much.

        0.0 if the errors need the whole limit, inf if the sampling instants are known.
        """
        left = self.limit_cycles - self._taken_cycles
        if left < self._rest_cycles(0.0) - ROUNDING_CYCLES:
            left = self.limit_cycles
        return self._speed(left - self.phase_cycles)

    @property
    def least_sync_hz(self) -> float:
        """The SYNC rate below which the acceleration takes too much; inf if no rate is enough.

        With 2010:01: a limit that is narrowed by 2010:02 follows the rate. A speed that is too high alone
        does not count.
        """
        taken, widest = self._taken_cycles, self.module.widest_limit_cycles
        left = widest - self._rest_cycles(self._instants_cycles)
        if left <= 0.0:
            left = widest - self._rest_cycles(0.0)
        if not taken:
            return 0.0
        return self.situation.sync_hz * math.sqrt(taken / left) if left > 0.0 else math.inf

    @property
    def jerk_rad_s2(self) -> float | None:
        """How far the jerk changes the acceleration within one interval; the prediction does not use it."""
        jerk = self.situation.motion.jerk_rad_s3
        return None if jerk is None else jerk * self.interval_s

    @cached_property
    def worst_interval_s(self) -> float:
        """The equal intervals that would do what unequal ones do at worst.

        Eq. 9 with intervals g and h leaves a h (g + h)/2, here with instants off by +-jitter; without
        sample times they count as equal, and as an error of the position.
        """
        if not self.module.times or self.module.samples_itself:
            return self.interval_s
        off = self.sync_jitter_s
        return math.sqrt((self.interval_s + 2.0 * off) * (self.interval_s + off))

    def acceleration_cycles(self, acceleration_rad_s2: float) -> float:
        """The residual that an acceleration leaves."""
        return cycles_per_interval_squared(
            acceleration_rad_s2, self.module.cycles_per_revolution, self.worst_interval_s
        )

    def _rest_cycles(self, instants_cycles: float) -> float:
        """All but the acceleration, not below what the module itself allows for an uncorrected phase."""
        uncorrected = self.situation.errors.phase_cycles is None and not self.module.has_table
        rest = self.phase_cycles + instants_cycles
        return max(rest, PHASE_ERROR_MARGIN_CYCLES) if uncorrected else rest

    @property
    def _taken_cycles(self) -> float:
        return self.acceleration_cycles(self.asked_rad_s2 or 0.0)

    @cached_property
    def _instants_cycles(self) -> float:
        cycles_per_s = (
            (self.situation.motion.speed_rad_s or 0.0) * self.module.cycles_per_revolution / (2 * math.pi)
        )
        return WEIGHT * cycles_per_s * self.uncertainty_s

    def _acceleration(self, left_cycles: float, rate_hz: float) -> float:
        cycles = self.module.cycles_per_revolution
        return max_acceleration(cycles, rate_hz, min(left_cycles, 0.5)) if left_cycles > 0.0 else 0.0

    def _speed(self, left_cycles: float) -> float:
        if left_cycles <= 0.0:
            return 0.0
        uncertainty = self.uncertainty_s
        return (
            max_speed(self.module.cycles_per_revolution, uncertainty, left_cycles)
            if uncertainty
            else math.inf
        )


def over(limit: float, value: float) -> float:
    """The margin of a limit as a factor; inf if nothing is asked, or nothing limits."""
    if value == 0.0 or math.isinf(limit):
        return math.inf
    factor = limit / value
    return 1.0 if math.isclose(factor, 1.0, rel_tol=ROUNDING) else factor
