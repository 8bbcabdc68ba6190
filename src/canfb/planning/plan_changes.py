"""What to change, and what first: each row of the table is tried on the plan before it is proposed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from canfb.planning.change_table import (
    CHANGES,
    NARROWER,
    SHARPER,
    ChangeCase,
    ChangeRow,
    asked_acceleration,
    is_sharp,
    motion_holds,
    widest_limit,
)
from canfb.planning.plan import Limited, Margin, Plan
from canfb.planning.plan_input import PlanInput

NARROWED = 0.95  # of the residual limit: a gain
DETECTION = "detection"


@dataclass(frozen=True)
class PlanChange:
    """One change: what it widens, what to do in one line, and the input of the plan then."""

    for_what: str
    text: str
    plan_input: PlanInput


def changes_of(plan: Plan) -> list[PlanChange]:
    """What to change, in order: first what is exceeded most, at last what makes the detection sharp.

    Each makes its limit hold, as long as one change can; a plan that needs more is left where the changes
    end. Empty if nothing is to be gained.
    """
    steps: list[PlanChange] = []
    while not plan.holds:
        found = _for(plan, plan.tightest)
        if found is None or found.for_what in (step.for_what for step in steps):
            return steps
        steps.append(found)
        plan = Plan(found.plan_input)
    return [*steps, *_sharper(plan)]


def _for(plan: Plan, margin: Margin) -> PlanChange | None:
    """The first change that harms nothing else; where each one does, the first that helps."""
    budget = next((one for one in plan.budgets if one.module is margin.module), plan.budgets[0])
    second: PlanChange | None = None
    for text, after in _tried(CHANGES[margin.limited], ChangeCase(plan, budget)):
        if _smallest(after).get(margin.limited, math.inf) < 1.0:
            continue
        found = PlanChange(margin.limited.value, text, after.plan_input)
        if _harms_nothing(plan, after):
            return found
        second = second or found
    return second


def _sharper(plan: Plan) -> Iterator[PlanChange]:
    """What narrows the residual limit of a plan that holds, so that the count is guarded well."""
    if not asked_acceleration(plan):
        return
    for text, after in _tried(NARROWER, ChangeCase(plan, plan.budgets[0])):
        if after.holds and widest_limit(after) < NARROWED * widest_limit(plan):
            yield PlanChange(DETECTION, text, after.plan_input)
            plan = after
            break
    if is_sharp(plan):
        return
    for text, after in _tried(SHARPER, ChangeCase(plan, plan.budgets[0])):
        if after.holds and is_sharp(after):
            yield PlanChange(DETECTION, text, after.plan_input)
            return


def _tried(ways: Iterable[ChangeRow], case: ChangeCase) -> Iterator[tuple[str, Plan]]:
    for way in ways:
        for value in way.values(case):
            try:
                after = Plan(way.change(case.given, value))
            except ValueError:  # no RPDO has room for it
                continue
            if not way.whole or motion_holds(after):
                yield way.text.format(*(value if isinstance(value, tuple) else (value,))), after


def _harms_nothing(before: Plan, after: Plan) -> bool:
    """No limit is newly exceeded, or exceeded by more."""
    was, becomes = _smallest(before), _smallest(after)
    return all(factor >= min(1.0, was.get(one, 1.0)) for one, factor in becomes.items())


def _smallest(plan: Plan) -> dict[Limited, float]:
    """The smallest factor of each limit; those of the plan come in order."""
    found: dict[Limited, float] = {}
    for margin in plan.margins:
        found.setdefault(margin.limited, margin.factor)
    return found
