"""What makes the detection of a plan sharp that holds: a narrower residual limit."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

from canfb.planning.budget import ResidualBudget
from canfb.planning.changes import (
    NOISE_MARGIN,
    Proposals,
    Remedy,
    each,
    knowing,
    knowing_jerk,
    limited,
    noise_margined,
    rounded_limit,
    third_order,
)
from canfb.planning.detection import WELL, WELL_THIRD_ORDER
from canfb.planning.phase_errors import SECOND_DIFFERENCE, THIRD_DIFFERENCE, Weights
from canfb.planning.plan import Plan
from canfb.planning.planned_module import PlannedModule
from canfb.signal.tracker import RESIDUAL_LIMIT
from canfb.simulation.demand import rounded_up

LEAVES = 0.95  # of what is sharp
NARROWER = 0.95  # of the residual limit: a gain
KNOWN_ENOUGH = 1.1  # what the module knows over what is stated


class _Known(NamedTuple):
    """What of the motion narrows the residual limit, if the module knows it."""

    key: str
    asked: Callable[[ResidualBudget], float | None]
    known: Callable[[PlannedModule], float]
    knowing: Callable[[PlannedModule, float], PlannedModule]
    weights: Weights
    well: float


ACCELERATION = _Known(
    "max_acceleration_rad_s2 (2010:02)",
    lambda budget: budget.asked_rad_s2,
    lambda module: module.known_acceleration_rad_s2,
    knowing,
    SECOND_DIFFERENCE,
    WELL,
)
JERK = _Known(
    "max_jerk_rad_s3 (2010:08)",
    lambda budget: budget.asked_rad_s3,
    lambda module: module.known_jerk_rad_s3,
    knowing_jerk,
    THIRD_DIFFERENCE,
    WELL_THIRD_ORDER,
)


def sharper(plan: Plan) -> Iterator[Remedy]:
    """What narrows the residual limit of a plan that holds, so that the count is guarded well.

    Nothing for modules that predict by different orders.
    """
    orders = {module.is_third_order for module in plan.situation.modules}
    if len(orders) > 1:
        return
    kind = JERK if orders == {True} else ACCELERATION
    stated = max(kind.asked(budget) or 0.0 for budget in plan.budgets)
    if not stated:
        return
    for text, situation in _narrowing(plan, kind, stated):
        after = Plan(situation)
        if after.holds and _widest(after) < NARROWER * _widest(plan):
            yield Remedy("detection", text, situation)
            plan = after
            break
    if _is_sharp(plan):
        return
    for text, situation in (*_by_noise(plan, kind), *_by_third_order(plan, kind), *_faster(plan, kind)):
        after = Plan(situation)
        if after.holds and _is_sharp(after):
            yield Remedy("detection", text, situation)
            return


def _narrowing(plan: Plan, kind: _Known, stated: float) -> Proposals:
    situation = plan.situation
    if any(not 0.0 < kind.known(module) <= KNOWN_ENOUGH * stated for module in situation.modules):
        narrowed = each(situation, lambda module: kind.knowing(module, stated))
        limit = max(budget.limit_cycles for budget in Plan(narrowed).budgets)
        yield f"set {kind.key} to {stated:.6g}: the residual limit becomes {limit:.3f}", narrowed
    limit = rounded_limit(max(budget.needed_cycles for budget in plan.budgets))
    text = f"lower residual_limit (2010:01) to {limit:.3f} cycle"
    if limit <= RESIDUAL_LIMIT and not any(kind.known(module) for module in situation.modules):
        yield text, each(situation, lambda module: limited(module, limit))


def _by_noise(plan: Plan, kind: _Known) -> Proposals:
    if all(kind.known(module) for module in plan.situation.modules):
        situation = each(plan.situation, noise_margined)
        limit = max(budget.limit_cycles for budget in Plan(situation).budgets)
        yield (
            f"set noise_margin (2010:09) to {NOISE_MARGIN}: the residual limit becomes {limit:.3f}",
            situation,
        )


def _by_third_order(plan: Plan, kind: _Known) -> Proposals:
    jerk = plan.situation.motion.jerk_rad_s3
    if kind is ACCELERATION and jerk:
        text = f"set prediction_order: 3 (2010:07), and {JERK.key} to {jerk:.6g}"
        yield text, each(plan.situation, lambda module: knowing_jerk(third_order(module), jerk))


def _faster(plan: Plan, kind: _Known) -> Proposals:
    """The rate at which motion + margin + motion is sharp: the limit follows the rate."""
    if not all(kind.known(module) for module in plan.situation.modules):
        return
    declared = max(module.declared_phase_error_cycles for module in plan.situation.modules)
    least = (kind.well - kind.weights.errors * declared) / 2.0 * LEAVES
    widest = max(plan.budgets, key=lambda budget: budget.motion_part.cycles)
    taken = widest.motion_part.cycles
    if taken > least:
        rate_hz = float(rounded_up(plan.situation.sync_hz * (taken / least) ** (1.0 / widest.power)))
        yield f"raise the SYNC rate to {rate_hz:g} Hz", replace(plan.situation, sync_hz=rate_hz)


def _is_sharp(plan: Plan) -> bool:
    return all(plan.detection(budget).is_sharp for budget in plan.budgets)


def _widest(plan: Plan) -> float:
    return max(budget.limit_cycles for budget in plan.budgets)
