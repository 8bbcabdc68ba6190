"""The budget of the residual limit with third-order prediction (2010:07 = 3).

The motion leaves j N/(2 pi) T^3 with the jerk j. If no jerk is known, the acceleration steps from 0 to a
between two samples, which leaves 3/4 a N/(2 pi) T^2: the largest third difference of a parabola that begins
there. 2010:02, where it is set, limits the second difference as well.
"""

from __future__ import annotations

import math
from functools import cached_property

from canfb.planning.budget import (
    ROUNDING_CYCLES,
    SECOND_DIFFERENCE,
    THIRD_DIFFERENCE,
    ResidualBudget,
    ResidualPart,
)
from canfb.planning.plan_input import PlanInput
from canfb.planning.planned_module import PlannedModule
from canfb.signal.limits import cycles_per_interval_cubed, cycles_per_interval_squared, max_jerk

OF_A_STEP = 0.75


class JerkBudget(ResidualBudget):
    """As :class:`ResidualBudget`, for a module that predicts with constant acceleration."""

    weights = THIRD_DIFFERENCE

    @property
    def steps(self) -> bool:
        """No jerk is known: the acceleration steps."""
        return self.asked_rad_s3 is None

    @cached_property
    def motion_part(self) -> ResidualPart:
        """What the jerk leaves, or a step of the acceleration."""
        jerk = self.asked_rad_s3
        if jerk is not None:
            return ResidualPart("jerk", jerk * self._cycles_per_rad_s3)
        return ResidualPart(
            "step of the acceleration", (self.asked_rad_s2 or 0.0) * self._cycles_per_rad_s2_of_a_step
        )

    @property
    def power(self) -> int:
        """Of the interval, with which the residual of the motion grows."""
        return 2 if self.steps else 3

    @property
    def equation_rad_s3(self) -> float:
        """The jerk that the residual limit allows without any errors (:func:`canfb.max_jerk`)."""
        return max_jerk(self.module.cycles_per_revolution, self.sample_hz, min(self.limit_cycles, 0.5))

    @property
    def largest_jerk_rad_s3(self) -> float:
        """With the speed as given, unless that alone is too much; 0.0 if the errors need the whole limit."""
        return max(0.0, self.left_in_force_cycles) / self._cycles_per_rad_s3

    @property
    def largest_acceleration_rad_s2(self) -> float:
        """As a step, where no jerk is known; by 2010:02, where it is set; inf without both."""
        instants = self.instants_cycles(SECOND_DIFFERENCE)
        if self.uncertainty_s:  # what the module knows of it widens this limit as well
            instants *= 1.0 - self.known_uncertainty_s / self.uncertainty_s
        left = self._known_cycles - self.rest_cycles(instants, SECOND_DIFFERENCE)
        largest = max(0.0, left) / self.acceleration_cycles(1.0)
        if not self.steps:
            return largest
        step = max(0.0, self.left_in_force_cycles) / self._cycles_per_rad_s2_of_a_step
        return min(largest, step)

    @property
    def largest_speed_rad_s(self) -> float:
        """With the motion as given; 2010:02 leaves as much for errors as with eq. 9."""
        left = self._known_cycles - self.acceleration_cycles(self.asked_rad_s2 or 0.0)
        if left < self.rest_cycles(0.0, SECOND_DIFFERENCE) - ROUNDING_CYCLES:
            left = self._known_cycles
        own_s = self.uncertainty_s - self.known_uncertainty_s
        checked = self.speed_rad_s(left - self.phase_cycles(SECOND_DIFFERENCE), SECOND_DIFFERENCE, own_s)
        return min(super().largest_speed_rad_s, math.inf if math.isinf(self._known_cycles) else checked)

    @property
    def _known_cycles(self) -> float:
        """The limit of the second difference; inf while 2010:02 is 0."""
        known = self.module.known_acceleration_rad_s2
        if not known:
            return math.inf
        cycles = cycles_per_interval_squared(known, self.module.cycles_per_revolution, self.interval_s)
        return cycles + SECOND_DIFFERENCE.errors * self.known_phase_error_cycles

    @property
    def worst_interval_s(self) -> float:
        """The nominal one: the module holds samples at unequal intervals against a limit that grows alike."""
        return self.interval_s

    @cached_property
    def _stretched(self) -> float:
        """The scale of the longest interval after the shortest: e (e + f) (e + f + g)/6, newest first, T = 1.

        The module multiplies its limit by it, as far as one cycle in the window remains: to 1/2.
        """
        off = self.off_s / self.interval_s
        return (1.0 + 2.0 * off) * (2.0 + 2.0 * off) * (3.0 + 2.0 * off) / 6.0

    @cached_property
    def _two_cycles(self) -> float:
        """By how much the limit would be over 1/2 then."""
        return max(1.0, 2.0 * self.limit_cycles * self._stretched)

    @cached_property
    def _cycles_per_rad_s3(self) -> float:
        cycles = cycles_per_interval_cubed(1.0, self.module.cycles_per_revolution, self.interval_s)
        return cycles * self._two_cycles

    @cached_property
    def _cycles_per_rad_s2_of_a_step(self) -> float:
        longest = (1.0 + 2.0 * self.off_s / self.interval_s) ** 2
        return OF_A_STEP * self.acceleration_cycles(1.0) * longest / self._stretched * self._two_cycles


def budget_of(plan_input: PlanInput, module: PlannedModule) -> ResidualBudget:
    """The budget of the module's order."""
    return JerkBudget(plan_input, module) if module.is_third_order else ResidualBudget(plan_input, module)
