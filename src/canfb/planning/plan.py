"""A plan: the limits of its input, each with its margin, and which errors of the count cannot pass.

n samples in a row are without harm while (n + 2) (L + a) <= 1 and floor((n + 2)^2 / 4) (L + a) <= 1, L the
residual limit, a the acceleration in cycles per interval squared (docs/supervision.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from typing import Any

from canfb.planning.budget import ResidualBudget, over
from canfb.planning.plan_input import PlanInput
from canfb.planning.planned_module import PlannedModule
from canfb.signal.declared import Declared
from canfb.signal.limits import ROUNDING, samples_without_harm

WELL = 1.0 / 6.0  # docs/supervision.md: keep the limit below 1/6


@dataclass(frozen=True)
class CountDetection:
    """What a supervision by eq. 12 detects.

    limit_cycles       the residual limit, L
    motion_cycles      what the motion uses of it: the largest acceleration, cycles per interval squared
    declared           what is declared of machine and encoder: the motions that are followed after a gap
    """

    limit_cycles: float
    motion_cycles: float
    declared: Declared

    @property
    def bad_samples(self) -> int:
        return samples_without_harm(self.limit_cycles + self.motion_cycles)

    @property
    def missed_samples(self) -> int:
        return self.declared.kept_samples(self.motion_cycles)

    def kept_with(self, **declared: Any) -> int:
        """:attr:`missed_samples` if this were declared instead, by the names of :class:`Declared`."""
        return replace(self.declared, **declared).kept_samples(self.motion_cycles)

    @property
    def is_declared(self) -> bool:
        return self.motion_cycles <= self.declared.followed + ROUNDING

    @property
    def unseen_jump_cycles(self) -> float:
        """A jump of the phase below this one may pass."""
        return self.limit_cycles

    @property
    def half_cycle(self) -> bool:
        """A jump of half a cycle (both tracks inverted) is seen at once."""
        return self.limit_cycles + self.motion_cycles < 0.5

    @property
    def is_sharp(self) -> bool:
        """Below 1/6 (docs/supervision.md)."""
        return self.limit_cycles + self.motion_cycles <= WELL + ROUNDING


class Limited(StrEnum):
    """What has a limit."""

    BUS = "bus load"
    SPEED = "speed"
    ACCELERATION = "acceleration"
    RESIDUAL = "residual"


@dataclass(frozen=True)
class Margin:
    """A given value against its limit.

    module    whose limit it is; None: that of the bus
    factor    limit over value; inf where nothing is limited or nothing is asked
    """

    limited: Limited
    module: PlannedModule | None
    factor: float

    @property
    def holds(self) -> bool:
        return self.factor >= 1.0


@dataclass(frozen=True)
class Plan:
    """What :class:`canfb.planning.plan_input.PlanInput` allows."""

    plan_input: PlanInput

    @cached_property
    def budgets(self) -> tuple[ResidualBudget, ...]:
        return tuple(ResidualBudget(self.plan_input, module) for module in self.plan_input.modules)

    @cached_property
    def margins(self) -> tuple[Margin, ...]:
        """The smallest factor first."""
        return tuple(sorted(self._margins(), key=lambda margin: margin.factor))

    @property
    def tightest(self) -> Margin:
        return self.margins[0]

    @property
    def holds(self) -> bool:
        return all(margin.holds for margin in self.margins)

    def detection(self, budget: ResidualBudget, limit_cycles: float | None = None) -> CountDetection:
        limit = budget.limit_cycles if limit_cycles is None else limit_cycles
        declared = budget.declared
        if limit != budget.limit_cycles:
            declared = replace(declared, residual_limit=limit)
        return CountDetection(limit, budget.motion_cycles, declared)

    def _margins(self) -> Iterator[Margin]:
        load, speed = self.plan_input.bus.load, self.plan_input.speed_rad_s
        yield Margin(Limited.BUS, None, over(1.0, load))
        for budget in self.budgets:
            module = budget.module
            if speed is not None:
                yield Margin(Limited.SPEED, module, over(budget.largest_speed_rad_s, speed))
            if budget.asked_rad_s2 is not None:
                limit = budget.largest_acceleration_rad_s2
                yield Margin(Limited.ACCELERATION, module, over(limit, budget.asked_rad_s2))
            yield Margin(Limited.RESIDUAL, module, budget.margin)
