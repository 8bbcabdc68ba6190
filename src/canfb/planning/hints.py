"""Proposed changes for each exceeded limit, cheapest first, each tried on the plan."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from canfb import objects as od
from canfb.planning.plan import RPM, SHARP, WEIGHTS, Limited, Margin, Plan
from canfb.planning.planned_bus import BIT_RATES
from canfb.signal.sample import MOST_PER_SYNC
from canfb.signal.tracker import RESIDUAL_LIMIT
from canfb.simulation.set_up import rounded_up
from canfb.view.module_view import LIMIT_UNITS

LEAVES = 0.95  # part of a limit (largest SYNC rate, 1/6 of a sharp detection) that a hint uses
FASTER = 1.05
MOST_FASTER = 40  # steps of FASTER that are tried, up to 7 times the rate
KNOWN_ENOUGH = 1.1  # 2010:02 / given acceleration below which 2010:02 need not be lowered
NOISE_MARGIN = 6  # proposed 2010:09, see docs/supervision.md
NARROWED = 0.95  # a change must narrow the residual limit at least to this part
NUMBERS = {2: "two", 3: "three", 4: "four", 5: "five", 6: "six", 7: "seven", 8: "eight"}
Ways = Iterator[tuple[str, Plan]]  # Changes: what to do, in one line, and the resulting plan.


@dataclass(frozen=True)
class PlanChange:
    """One change: the limit that it helps, what to do in one line, and the resulting plan."""

    for_what: str
    text: str
    plan: Plan


def changes_of(plan: Plan) -> list[PlanChange]:
    """The changes in order: first for the limit that is exceeded most, last for a sharp detection. Empty:
    none required."""
    steps: list[PlanChange] = []
    while not plan.holds:
        found = _for(plan, plan.tightest)
        if found is None or found.for_what in (step.for_what for step in steps):
            return steps
        steps.append(found)
        plan = found.plan
    limit = widest_limit(plan)
    for ways, gains in ((_narrower, lambda one: widest_limit(one) < NARROWED * limit), (_sharper, is_sharp)):
        if asked_acceleration(plan):
            good = (step for step in ways(plan) if step[1].holds and gains(step[1]))
            for text, after in list(good)[:1]:
                steps.append(PlanChange("detection", text, after))
                plan = after
    return steps


def _for(plan: Plan, margin: Margin) -> PlanChange | None:
    """The first change that helps and impairs no other margin, else the first that helps."""
    was = {one.limited: one.factor for one in reversed(plan.margins)}
    ways = {Limited.BUS: _of_the_bus, Limited.SPEED: _of_the_speed}.get(margin.limited, _of_the_motion)
    helping: list[PlanChange] = []
    for text, after in ways(plan):
        becomes = {one.limited: one.factor for one in reversed(after.margins)}
        if becomes.get(margin.limited, math.inf) >= 1.0:
            helping.append(PlanChange(margin.limited.value, text, after))
            if all(factor >= min(1.0, was.get(one, 1.0)) for one, factor in becomes.items()):
                return helping[-1]
    return helping[0] if helping else None


def _of_the_bus(plan: Plan) -> Ways:
    for faster in _faster_buses(plan):
        yield f"raise the bit rate to {faster.bit_rate} bit/s", faster
    rate_hz = LEAVES * plan.bus.largest_sync_hz
    if rate_hz > 0.0:
        unit = 10.0 ** (math.floor(math.log10(rate_hz)) - 1)
        rate_hz = math.floor(rate_hz / unit + 1e-9) * unit
        yield f"lower the SYNC rate to {rate_hz:g} Hz", replace(plan, sync_hz=rate_hz)
    all_of_them = len(plan.modules)
    for count in range(all_of_them - 1, 0, -1):
        yield (
            f"{count} of the {all_of_them} modules fit on this bus: give the others a second one",
            replace(plan, modules=plan.modules[:count]),
        )
    yield "other nodes leave no room: move them to another bus", replace(plan, extra_load=0.0)


def _of_the_speed(plan: Plan) -> Ways:
    yield from _times(plan)
    yield from _table(plan)
    rpm = _as_shown(min(one.largest_speed_rad_s for one in plan.budgets) * RPM)
    if rpm > 0.0:
        yield f"turn at {rpm:.15g} rpm at most", replace(plan, speed_rad_s=rpm / RPM)


def _of_the_motion(plan: Plan) -> Ways:
    asked = asked_acceleration(plan)
    yield from _times(plan)
    if any(0.0 < one.settings.acceleration_rad_s2 < asked for one in plan.modules):
        yield (
            f"set max_acceleration_rad_s2 (2010:02) to {asked:.7g}, which is what the motion needs",
            _with(plan, od.SUPERVISION_ACCELERATION, asked),
        )
    limit = _needed_limit(plan)
    if min(one.settings.widest_cycles for one in plan.modules) < limit <= RESIDUAL_LIMIT:
        yield f"raise residual_limit (2010:01) to {limit:.3f} cycle", _limited(plan, limit)
    yield from _table(plan)
    yield from _faster(plan)
    yield from _more_samples(plan)
    most = _as_shown(min(one.largest_acceleration_rad_s2 for one in plan.budgets))
    if 0.0 < most < asked:
        yield (
            f"accelerate by {most:.15g} rad/s^2 at most",
            replace(plan, acceleration_rad_s2=most, is_final=True),
        )
    yield (
        "average the tracks, or raise their amplitude: their noise alone exceeds the limit",
        replace(plan, noise_counts=0.0),
    )


def _times(plan: Plan) -> Ways:
    if not all(module.times for module in plan.modules):
        try:
            timed = (one.with_samples(one.settings.samples_per_sync, times=True) for one in plan.modules)
            after = replace(plan, modules=tuple(timed))
        except ValueError:  # the RPDOs have no room for times
            return
        yield "send sample times with the ADC PDO (times: true)", after


def _table(plan: Plan) -> Ways:
    if plan.phase_cycles is None and not all(module.has_table for module in plan.modules):
        modules = tuple(replace(module, has_table=True) for module in plan.modules)
        yield "measure the correction table (canfb calibrate)", replace(plan, modules=modules)


def _faster(plan: Plan) -> Ways:
    rate_hz = max(max(budget.least_sync_hz for budget in plan.budgets), plan.sync_hz * 1.01)
    for _ in range(MOST_FASTER if math.isfinite(rate_hz) else 0):
        after = replace(plan, sync_hz=float(rounded_up(rate_hz)))
        if all(margin.holds for margin in after.margins if margin.limited is not Limited.BUS):
            yield f"raise the SYNC rate to {after.sync_hz:g} Hz", after
            for one in _faster_buses(after):
                yield (
                    f"raise the SYNC rate to {one.sync_hz:g} Hz, and the bit rate to {one.bit_rate} bit/s",
                    one,
                )
            return
        rate_hz *= FASTER


def _more_samples(plan: Plan) -> Ways:
    for count in range(min(one.settings.samples_per_sync for one in plan.modules) + 1, MOST_PER_SYNC + 1):
        try:
            modules = tuple(
                one.with_samples(max(count, one.settings.samples_per_sync), times=one.times)
                for one in plan.modules
            )
            after = replace(plan, modules=modules)
        except ValueError:  # no free RPDO
            return
        if all(one.holds for one in after.margins if one.limited not in (Limited.BUS, Limited.SPEED)):
            more = sum(one.sample_bytes for one in modules) - sum(one.sample_bytes for one in plan.modules)
            load = 100.0 * (after.bus.load - plan.bus.load)
            cost = f"{more} bytes more for each SYNC, bus load +{load:.1f} %"
            text = f"send {NUMBERS[count]} samples for each SYNC (samples_per_sync: {count}; {cost})"
            yield f"{text}: sufficient for this motion", after


def _narrower(plan: Plan) -> Ways:
    asked, limit = asked_acceleration(plan), _needed_limit(plan)
    if not all(0.0 < one.settings.acceleration_rad_s2 <= KNOWN_ENOUGH * asked for one in plan.modules):
        yield _narrowed(plan, od.SUPERVISION_ACCELERATION, asked, "max_acceleration_rad_s2 (2010:02)")
    if limit <= RESIDUAL_LIMIT and not any(one.settings.acceleration_rad_s2 for one in plan.modules):
        yield f"lower residual_limit (2010:01) to {limit:.3f} cycle", _limited(plan, limit)


def _sharper(plan: Plan) -> Ways:
    if is_sharp(plan) or not all(one.settings.acceleration_rad_s2 for one in plan.modules):
        return
    yield _narrowed(plan, od.SUPERVISION_NOISE_MARGIN, NOISE_MARGIN, "noise_margin (2010:09)")
    declared = max(one.settings.phase_error_cycles for one in plan.modules)
    least = (SHARP - WEIGHTS * declared) / 2.0 * LEAVES
    taken = max(budget.motion_cycles for budget in plan.budgets)
    if taken > least > 0.0:
        rate_hz = float(rounded_up(plan.sync_hz * math.sqrt(taken / least)))
        yield f"raise the SYNC rate to {rate_hz:g} Hz", replace(plan, sync_hz=rate_hz)


def _as_shown(most: float) -> float:
    return float(f"{most * 0.9995:.4g}")  # rounding to four digits must not exceed the limit


def _narrowed(plan: Plan, place: od.Multiplexer, value: float, name: str) -> tuple[str, Plan]:
    after = _with(plan, place, value)
    return f"set {name} to {value:.7g}: the residual limit becomes {widest_limit(after):.3f}", after


def _with(plan: Plan, place: od.Multiplexer, value: float) -> Plan:
    return replace(plan, modules=tuple(one.with_values({place: value}) for one in plan.modules))


def _limited(plan: Plan, limit_cycles: float) -> Plan:
    return _with(plan, od.SUPERVISION_RESIDUAL_LIMIT, int(limit_cycles * LIMIT_UNITS))


def _faster_buses(plan: Plan) -> list[Plan]:
    load = plan.extra_load * plan.bit_rate
    return [
        replace(plan, bit_rate=rate, extra_load=load / rate) for rate in BIT_RATES if rate > plan.bit_rate
    ]


def _needed_limit(plan: Plan) -> float:
    """The limit needed, rounded up to 0.001: 2010:01 rounds down to 1/65536."""
    needed = max(budget.needed_cycles for budget in plan.budgets)
    return math.floor(min(needed, 1.0) * 1000.0 + 1.1) / 1000.0


def asked_acceleration(plan: Plan) -> float:
    return max(budget.asked_rad_s2 or 0.0 for budget in plan.budgets)


def is_sharp(plan: Plan) -> bool:
    return all(budget.detection().is_sharp for budget in plan.budgets)


def widest_limit(plan: Plan) -> float:
    return max(budget.limit_cycles for budget in plan.budgets)
