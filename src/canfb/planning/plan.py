"""A plan: the limits of its input, each with its margin, and whether all of them hold."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property

from canfb.planning.budget import ResidualBudget, over
from canfb.planning.detection import CountDetection, JerkDetection
from canfb.planning.jerk_budget import budget_of
from canfb.planning.planned_module import PlannedModule
from canfb.planning.situation import Situation


class Limited(StrEnum):
    """What has a limit."""

    BUS = "bus load"
    SPEED = "speed"
    ACCELERATION = "acceleration"
    JERK = "jerk"
    RESIDUAL = "residual"


@dataclass(frozen=True)
class Margin:
    """A stated value against its limit.

    module    whose limit it is; None: that of the bus
    factor    limit over value; inf where nothing is limited or nothing is asked
    """

    limited: Limited
    module: PlannedModule | None
    factor: float

    @property
    def holds(self) -> bool:
        """The limit is not exceeded."""
        return self.factor >= 1.0


@dataclass(frozen=True)
class Plan:
    """What :class:`canfb.planning.situation.Situation` allows."""

    situation: Situation

    @cached_property
    def budgets(self) -> tuple[ResidualBudget, ...]:
        """One for each module."""
        return tuple(budget_of(self.situation, module) for module in self.situation.modules)

    @cached_property
    def margins(self) -> tuple[Margin, ...]:
        """The smallest factor first."""
        return tuple(sorted(self._margins(), key=lambda margin: margin.factor))

    @property
    def tightest(self) -> Margin:
        """The limit with the smallest margin."""
        return self.margins[0]

    @property
    def holds(self) -> bool:
        """No limit is exceeded."""
        return all(margin.holds for margin in self.margins)

    def detection(self, budget: ResidualBudget, limit_cycles: float | None = None) -> CountDetection:
        """Detection with this residual limit; None: the one in force."""
        limit = budget.limit_cycles if limit_cycles is None else limit_cycles
        kind = JerkDetection if budget.module.is_third_order else CountDetection
        declared = budget.declared
        if limit != budget.limit_cycles:
            declared = replace(declared, residual_limit=limit)
        return kind(limit, budget.motion_part.cycles, declared)

    def _margins(self) -> Iterator[Margin]:
        load, motion = self.situation.bus.load, self.situation.motion
        yield Margin(Limited.BUS, None, over(1.0, load))
        for budget in self.budgets:
            module = budget.module
            if motion.speed_rad_s is not None:
                yield Margin(Limited.SPEED, module, over(budget.largest_speed_rad_s, motion.speed_rad_s))
            if budget.asked_rad_s2 is not None:
                limit = budget.largest_acceleration_rad_s2
                yield Margin(Limited.ACCELERATION, module, over(limit, budget.asked_rad_s2))
            if module.is_third_order and budget.asked_rad_s3 is not None:
                jerk = budget.asked_rad_s3
                yield Margin(Limited.JERK, module, over(budget.largest_jerk_rad_s3, jerk))
            yield Margin(Limited.RESIDUAL, module, budget.margin)
