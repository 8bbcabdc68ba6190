"""What uses up the residual limit of a module (eq. 12), and the limits of the motion that follow.

The residual of a healthy machine is at most

    motion  +  w v u  +  w e  +  noise

with the speed v, the error e of a phase and the uncertainty u of the sampling instant: without sample times
half the range of the SYNC, with them half a unit of the sample time. w is 4 for eq. 9, 8 for third-order
prediction. What the motion leaves is, for eq. 9, a N/(2 pi) T^2 with the acceleration a; unequal intervals T,
which sample times allow, make it larger. :mod:`canfb.planning.jerk_budget` is that of third-order prediction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from canfb.planning.planned_module import PlannedModule
from canfb.planning.situation import Situation
from canfb.signal.limits import (
    JERK_MARGIN_CYCLES,
    PHASE_ERROR_MARGIN_CYCLES,
    cycles_per_interval_squared,
    max_acceleration,
    max_speed,
)
from canfb.signal.third_order import SECOND, THIRD

HALF_TICK_S = 50e-9  # a sample time is rounded down to 100 ns
RAW_PHASE_ERROR_CYCLES = 0.0113  # of Table 1, without a correction table
TABLE_PHASE_ERROR_CYCLES = 0.001  # of what a reference measurement leaves
PEAK = 6.0  # standard deviations of the noise: one healthy sample in 5e8 is further off
ROUNDING_VARIANCE = 1.0 / 12.0  # counts^2
ROUNDING, ROUNDING_CYCLES = 1e-6, 1e-9  # of sums: a limit that is narrowed to the motion holds


class Weights(NamedTuple):
    """How a difference of phases adds up their errors.

    order            of the prediction
    errors           sum of the sizes of the weights
    variance         sum of their squares
    margin_cycles    what the module keeps for the errors of an uncorrected encoder
    """

    order: int
    errors: float
    variance: float
    margin_cycles: float


SECOND_DIFFERENCE = Weights(SECOND, 4.0, 6.0, PHASE_ERROR_MARGIN_CYCLES)  # 1, 2, 1
THIRD_DIFFERENCE = Weights(THIRD, 8.0, 20.0, JERK_MARGIN_CYCLES)  # 1, 3, 3, 1


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

    weights = SECOND_DIFFERENCE

    @property
    def interval_s(self) -> float:
        """The nominal sampling interval."""
        return 1.0 / self.situation.sync_hz

    @cached_property
    def limit_cycles(self) -> float:
        """The residual limit in force."""
        return self.module.residual_limit_cycles(self.interval_s)

    @property
    def is_narrowed(self) -> bool:
        """What is known of the machine is narrower than 2010:01."""
        return self.limit_cycles < self.module.widest_limit_cycles

    @property
    def asked_rad_s2(self) -> float | None:
        """The largest acceleration that the module has to follow; None: not stated."""
        return self.situation.motion.acceleration_of(self.module)

    @property
    def asked_rad_s3(self) -> float | None:
        """The largest jerk of the machine; None: not stated."""
        return self.situation.motion.jerk_of(self.module)

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
        instants = self.instants_cycles()
        return (
            self.motion_part,
            ResidualPart("sampling instants", instants),
            ResidualPart("errors of the encoder", self.rest_cycles(instants) - instants),
        )

    @cached_property
    def motion_part(self) -> ResidualPart:
        """What the motion leaves."""
        return ResidualPart("acceleration", self.acceleration_cycles(self.asked_rad_s2 or 0.0))

    @cached_property
    def needed_cycles(self) -> float:
        """The largest residual of the healthy machine; the limit has to be above it."""
        return sum(part.cycles for part in self.parts)

    @property
    def margin(self) -> float:
        """Residual limit over what is needed."""
        return over(self.limit_cycles, self.needed_cycles)

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
        return self._acceleration(self.left_cycles(self.limit_cycles), 1.0 / self.worst_interval_s)

    @property
    def largest_jerk_rad_s3(self) -> float:
        """With the speed as stated; inf: eq. 9 limits the acceleration alone."""
        return math.inf

    @property
    def equation_rad_s3(self) -> float:
        """The jerk that the residual limit allows without any errors; inf: eq. 9 does not limit it."""
        return math.inf

    @property
    def equation_speed_rad_s(self) -> float:
        """The speed that w v u < L allows without any errors; inf without an uncertainty."""
        return self.speed_rad_s(self.limit_cycles, self.weights)

    @property
    def largest_speed_rad_s(self) -> float:
        """With the acceleration as stated, unless that alone is too much.

        0.0 if the errors need the whole limit, inf if the sampling instants are known.
        """
        left = self.limit_cycles - self.motion_part.cycles
        if left < self.rest_cycles(0.0) - ROUNDING_CYCLES:
            left = self.limit_cycles
        return self.speed_rad_s(left - self.phase_cycles(), self.weights)

    @property
    def least_sync_hz(self) -> float:
        """The SYNC rate below which the motion takes too much; inf if no rate is enough.

        With 2010:01: a limit that is narrowed follows the rate. A speed that is too high alone does not
        count.
        """
        taken, left = self.motion_part.cycles, self.left_cycles(self.module.widest_limit_cycles)
        if not taken:
            return 0.0
        return self.situation.sync_hz * (taken / left) ** (1.0 / self.power) if left > 0.0 else math.inf

    @property
    def jerk_rad_s2(self) -> float | None:
        """How far the jerk changes the acceleration within one interval; None: not stated."""
        return None if self.asked_rad_s3 is None else self.asked_rad_s3 * self.interval_s

    @property
    def power(self) -> int:
        """Of the interval, with which the residual of the motion grows."""
        return 2

    @cached_property
    def off_s(self) -> float:
        """How far samples may be from equal intervals, +-, if their times are known.

        0.0 without sample times: they count as equal then, and as an error of the position.
        """
        return self.sync_jitter_s if self.module.times and not self.module.samples_itself else 0.0

    @property
    def worst_interval_s(self) -> float:
        """The equal intervals that would do to eq. 9 what unequal ones do at worst.

        With intervals g and h it leaves a h (g + h)/2, here with instants off by +-jitter.
        """
        return math.sqrt((self.interval_s + 2.0 * self.off_s) * (self.interval_s + self.off_s))

    def acceleration_cycles(self, acceleration_rad_s2: float) -> float:
        """The second difference that an acceleration leaves."""
        return cycles_per_interval_squared(
            acceleration_rad_s2, self.module.cycles_per_revolution, self.worst_interval_s
        )

    def noise_cycles(self, weights: Weights | None = None) -> float:
        """The noise of the tracks in a difference of phases, at most; that of the residual by default."""
        errors = self.situation.errors
        counts = math.sqrt(errors.noise_counts**2 + ROUNDING_VARIANCE)
        amplitude = errors.amplitude * self.module.full_scale_counts
        if not amplitude:
            return math.inf
        variance = (weights or self.weights).variance
        return PEAK * math.sqrt(variance) * counts / (2.0 * math.pi * amplitude)

    def phase_cycles(self, weights: Weights | None = None) -> float:
        """Errors of the phases in a difference, without those of their instants."""
        stated = self.situation.errors.phase_cycles
        if stated is None:
            stated = TABLE_PHASE_ERROR_CYCLES if self.module.has_table else RAW_PHASE_ERROR_CYCLES
        return (weights or self.weights).errors * stated + self.noise_cycles(weights)

    def instants_cycles(self, weights: Weights | None = None) -> float:
        """Errors of the sampling instants in a difference of phases."""
        cycles = self.module.cycles_per_revolution
        cycles_per_s = (self.situation.motion.speed_rad_s or 0.0) * cycles / (2 * math.pi)
        return (weights or self.weights).errors * cycles_per_s * self.uncertainty_s

    def rest_cycles(self, instants_cycles: float, weights: Weights | None = None) -> float:
        """All but the motion, not below what the module itself allows for an uncorrected phase."""
        uncorrected = self.situation.errors.phase_cycles is None and not self.module.has_table
        rest = self.phase_cycles(weights) + instants_cycles
        return max(rest, (weights or self.weights).margin_cycles) if uncorrected else rest

    def left_cycles(self, limit_cycles: float) -> float:
        """What a limit leaves for the motion, with the speed as stated unless that alone is too much."""
        left = limit_cycles - self.rest_cycles(self.instants_cycles())
        return left if left > 0.0 else limit_cycles - self.rest_cycles(0.0)

    def speed_rad_s(self, left_cycles: float, weights: Weights) -> float:
        """The speed at which the sampling instants need so much; inf if they are known."""
        if left_cycles <= 0.0:
            return 0.0
        if not self.uncertainty_s:
            return math.inf
        cycles, order = self.module.cycles_per_revolution, weights.order
        return max_speed(cycles, self.uncertainty_s, min(left_cycles, 0.5), order)

    def _acceleration(self, left_cycles: float, rate_hz: float) -> float:
        cycles = self.module.cycles_per_revolution
        return max_acceleration(cycles, rate_hz, min(left_cycles, 0.5)) if left_cycles > 0.0 else 0.0


def over(limit: float, value: float) -> float:
    """The margin of a limit as a factor; inf if nothing is asked, or nothing limits."""
    if value == 0.0 or math.isinf(limit):
        return math.inf
    factor = limit / value
    return 1.0 if math.isclose(factor, 1.0, rel_tol=ROUNDING) else factor
