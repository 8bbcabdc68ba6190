"""What to change, and what first: each change is tried on the plan before it is proposed."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import replace

from canfb.planning.budget import ResidualBudget
from canfb.planning.bus_load import BIT_RATES
from canfb.planning.changes import (
    Proposals,
    Remedy,
    each,
    knowing,
    knowing_jerk,
    limited,
    rounded_limit,
    third_order,
    with_samples,
    with_table,
)
from canfb.planning.narrowing import sharper
from canfb.planning.plan import Limited, Margin, Plan
from canfb.planning.situation import Situation
from canfb.signal.subsamples import MOST_PER_SYNC
from canfb.signal.tracker import RESIDUAL_LIMIT
from canfb.simulation.demand import rounded_up

LEAVES = 0.95  # of the largest SYNC rate, of what jitter may be
FASTER = 1.05
LITTLE_FASTER = 1.25
MOST_FASTER = 40  # steps of FASTER: 7 times the rate


MOTION = (Limited.ACCELERATION, Limited.JERK, Limited.RESIDUAL)


def remedies_of(plan: Plan) -> list[Remedy]:
    """What to change, in order: first what is exceeded most, at last what makes the detection sharp.

    Each makes its limit hold, as long as one change can; a plan that needs more is left where the changes
    end. Empty if nothing is to be gained.
    """
    steps: list[Remedy] = []
    while not plan.holds:
        found = _for(plan, plan.tightest)
        if found is None or found.for_what in (step.for_what for step in steps):
            return steps
        steps.append(found)
        plan = Plan(found.situation)
    return [*steps, *sharper(plan)]


def _for(plan: Plan, margin: Margin) -> Remedy | None:
    """The first proposal that harms nothing else; where each one does, the first that helps."""
    second: Remedy | None = None
    for text, situation in PROPOSALS[margin.limited](plan, margin):
        after = Plan(situation)
        if _smallest(after).get(margin.limited, math.inf) < 1.0:
            continue
        found = Remedy(margin.limited.value, text, situation)
        if _harms_nothing(plan, after):
            return found
        second = second or found
    return second


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


def _at_bit_rate(situation: Situation, bit_rate: int) -> Situation:
    """The frames of other nodes are as many, and each takes less time."""
    extra = situation.extra_load * situation.bit_rate / bit_rate
    return replace(situation, bit_rate=bit_rate, extra_load=extra)


def _of_bus(plan: Plan, margin: Margin) -> Proposals:
    situation, bus = plan.situation, plan.situation.bus
    for bit_rate in BIT_RATES:
        if bit_rate > situation.bit_rate:
            yield f"raise the bit rate to {bit_rate} bit/s", _at_bit_rate(situation, bit_rate)
    rate_hz = _rounded_down(LEAVES * bus.largest_sync_hz)
    if rate_hz > 0.0:
        yield f"lower the SYNC rate to {rate_hz:g} Hz", replace(situation, sync_hz=rate_hz)
    for count in range(len(situation.modules) - 1, 0, -1):
        text = (
            f"{count} of the {len(situation.modules)} modules fit on this bus: give the others a second one"
        )
        yield text, replace(situation, modules=situation.modules[:count])
    yield "other nodes leave no room: move them to another bus", replace(situation, extra_load=0.0)


def _of_speed(plan: Plan, margin: Margin) -> Proposals:
    situation, budget = plan.situation, _budget(plan, margin)
    yield from _times(situation)
    yield from _table(situation)
    speed = situation.motion.speed_rad_s or 0.0
    by_jitter = not budget.module.times and budget.module.samples_per_sync == 1
    if budget.largest_speed_rad_s > 0.0 and by_jitter:
        # The largest speed goes with 1/u: so much smaller the uncertainty has to be.
        allowed_s = LEAVES * budget.uncertainty_s * budget.largest_speed_rad_s / speed
        jitter_s = allowed_s - (budget.uncertainty_s - situation.jitter_s)
        if jitter_s > 0.0:
            text = f"lower the jitter of the SYNC to ±{jitter_s * 1e6:.3g} µs"
            yield text, replace(situation, jitter_s=jitter_s)
    slower = min(one.largest_speed_rad_s for one in plan.budgets) * (1.0 - 1e-9)
    text = f"turn at {slower * 60.0 / (2.0 * math.pi):.4g} rpm at most"
    if slower > 0.0:
        yield text, replace(situation, motion=replace(situation.motion, speed_rad_s=slower))


def _of_residual(plan: Plan, margin: Margin) -> Proposals:
    situation, budget = plan.situation, _budget(plan, margin)
    yield from _times(situation)
    stated = budget.asked_rad_s2 or 0.0
    if 0.0 < budget.module.known_acceleration_rad_s2 < stated:
        text = f"set max_acceleration_rad_s2 (2010:02) to {stated:.4g}, which is what the motion needs"
        yield text, each(situation, lambda module: knowing(module, stated))
    jerk = budget.asked_rad_s3 or 0.0
    if budget.module.is_third_order and 0.0 < budget.module.known_jerk_rad_s3 < jerk:
        text = f"set max_jerk_rad_s3 (2010:08) to {jerk:.6g}, which is what the motion needs"
        yield text, each(situation, lambda module: knowing_jerk(module, jerk))
    limit = rounded_limit(max(one.needed_cycles for one in plan.budgets))
    if budget.module.widest_limit_cycles < limit <= RESIDUAL_LIMIT:
        text = f"raise residual_limit (2010:01) to {limit:.3f} cycle"
        yield text, each(situation, lambda module: limited(module, limit))
    yield from _table(situation)
    yield from _third_order(plan)
    least_hz = max(one.least_sync_hz for one in plan.budgets)
    a_little = least_hz <= LITTLE_FASTER * situation.sync_hz  # not worth another interface
    for way in (_several, _faster) if jerk and not a_little else (_faster, _several):
        yield from way(plan)
    yield from _gentler(plan)
    slower = min(one.largest_acceleration_rad_s2 for one in plan.budgets) * (1.0 - 1e-9)
    if stated and 0.0 < slower < stated:
        text = f"accelerate by {slower:.4g} rad/s^2 at most"
        yield (
            text,
            replace(situation, motion=replace(situation.motion, acceleration_rad_s2=slower, is_final=True)),
        )
    yield (
        "average the tracks, or raise their amplitude: their noise alone exceeds the limit",
        replace(situation, errors=replace(situation.errors, noise_counts=0.0)),
    )


PROPOSALS: dict[Limited, Callable[[Plan, Margin], Proposals]] = {
    Limited.BUS: _of_bus,
    Limited.SPEED: _of_speed,
    Limited.ACCELERATION: _of_residual,
    Limited.JERK: _of_residual,
    Limited.RESIDUAL: _of_residual,
}


def _times(situation: Situation) -> Proposals:
    if not all(module.times for module in situation.modules):
        with contextlib.suppress(ValueError):  # no RPDO has room for them
            changed = each(situation, lambda module: module.with_times())
            yield "send sample times with the ADC PDO (times: true)", changed


def _table(situation: Situation) -> Proposals:
    if situation.errors.phase_cycles is None and not all(module.has_table for module in situation.modules):
        text = "measure the correction table (canfb calibrate)"
        yield text, each(situation, with_table)


def _several(plan: Plan) -> Proposals:
    """More samples for each SYNC, of any order, if the move holds then."""
    situation = plan.situation
    fewest = min(module.samples_per_sync for module in situation.modules)
    by_third = bool(situation.motion.jerk_rad_s3) and not all(m.is_third_order for m in situation.modules)
    for per_sync in range(fewest + 1, MOST_PER_SYNC + 1):
        found = with_samples(situation, per_sync)
        if found is None or all(module.samples_itself for module in situation.modules):
            return
        text, after = found
        if _motion_holds(after):
            yield f"{text}: that holds this move", after
        elif by_third and _motion_holds(changed := each(after, third_order)):
            yield f"set prediction_order: 3 (2010:07), and {text}: that holds this move", changed


def _motion_holds(situation: Situation) -> bool:
    return all(margin.holds for margin in Plan(situation).margins if margin.limited in MOTION)


def _third_order(plan: Plan) -> Proposals:
    """2010:07 = 3 where a jerk is stated, alone or with a table, if the move holds then."""
    situation = plan.situation
    if not situation.motion.jerk_rad_s3 or all(module.is_third_order for module in situation.modules):
        return
    changed = each(situation, third_order)
    text = "set prediction_order: 3 (2010:07): order 3 holds this move"
    for extra, proposal in (("", changed), *((f"{one}, and ", after) for one, after in _table(changed))):
        if _motion_holds(proposal):
            yield extra + text, proposal


def _gentler(plan: Plan) -> Proposals:
    """Less jerk, where it is what counts."""
    situation = plan.situation
    gentle = min(one.largest_jerk_rad_s3 for one in plan.budgets) * (1.0 - 1e-9)
    if situation.motion.jerk_rad_s3 and 0.0 < gentle < situation.motion.jerk_rad_s3:
        text = f"limit the jerk to {gentle:.4g} rad/s^3"
        yield text, replace(situation, motion=replace(situation.motion, jerk_rad_s3=gentle))


def _faster(plan: Plan) -> Proposals:
    """A higher SYNC rate; with a higher bit rate, if the bus does not carry it."""
    situation = plan.situation
    rate_hz = max(budget.least_sync_hz for budget in plan.budgets)
    if math.isinf(rate_hz):
        return
    rate_hz = max(rate_hz, situation.sync_hz * 1.01)
    for _ in range(MOST_FASTER):
        rounded = float(rounded_up(rate_hz))
        faster = replace(situation, sync_hz=rounded)
        if all(margin.holds for margin in Plan(faster).margins if margin.limited is not Limited.BUS):
            yield f"raise the SYNC rate to {rounded:g} Hz", faster
            for bit_rate in BIT_RATES:
                if bit_rate > situation.bit_rate:
                    text = f"raise the SYNC rate to {rounded:g} Hz, and the bit rate to {bit_rate} bit/s"
                    yield text, _at_bit_rate(faster, bit_rate)
            return
        rate_hz *= FASTER


def _budget(plan: Plan, margin: Margin) -> ResidualBudget:
    return next(budget for budget in plan.budgets if budget.module is margin.module)


def _rounded_down(rate_hz: float) -> float:
    """In two or three figures."""
    if rate_hz <= 0.0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(rate_hz)) - 1)
    return math.floor(rate_hz / unit + 1e-9) * unit
