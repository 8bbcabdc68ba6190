"""The table of the changes that a plan proposes: what each is for, which values it tries, what it does.

A row has a text, the values to try, and what one of them does to the input of the plan. :data:`CHANGES` has
the rows for each limit, in the order of what they cost: a setting comes before another bus, and that before a
gentler machine. :data:`NARROWER` and :data:`SHARPER` are those of a plan that holds: a narrower residual
limit, then a detection that is sharp (docs/faults.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

from canfb import objects as od
from canfb.module.parameters import LIMIT_UNITS
from canfb.planning.budget import RPM, WEIGHTS, ResidualBudget
from canfb.planning.plan import WELL, Limited, Plan
from canfb.planning.plan_input import PlanInput
from canfb.planning.planned_module import PlannedModule
from canfb.planning.traffic import BIT_RATES
from canfb.signal.sample import MOST_PER_SYNC
from canfb.signal.tracker import RESIDUAL_LIMIT
from canfb.simulation.demand import rounded_up

LEAVES = 0.95  # of the largest SYNC rate, of what jitter may be, of what is sharp
FASTER = 1.05
MOST_FASTER = 40  # steps of FASTER: 7 times the rate
JUST_BELOW = 1.0 - 1e-9
KNOWN_ENOUGH = 1.1  # what the module knows over what is given
NOISE_MARGIN = 6  # docs/faults.md
MOTION = (Limited.ACCELERATION, Limited.RESIDUAL)
NUMBERS = {2: "two", 3: "three", 4: "four", 5: "five", 6: "six", 7: "seven", 8: "eight"}


class ChangeCase(NamedTuple):
    """What is to be changed: the plan, and the budget of the module whose limit it is for."""

    plan: Plan
    budget: ResidualBudget

    @property
    def given(self) -> PlanInput:
        """The input of the plan."""
        return self.plan.plan_input

    @property
    def modules(self) -> tuple[PlannedModule, ...]:
        """Those of the plan."""
        return self.given.modules

    def least(self, limit: Callable[[ResidualBudget], float]) -> float:
        """Just below the smallest of a limit."""
        return min(map(limit, self.plan.budgets)) * JUST_BELOW


class ChangeRow(NamedTuple):
    """A row of the table.

    text      with a place for the value, for each part of it if it is a tuple
    values    to try, in this order; none where the change makes no sense
    change    the input with the value; ValueError where there is no room for it
    whole     only where all of the motion holds then
    """

    text: str
    values: Callable[[ChangeCase], Iterable[Any]]
    change: Callable[[PlanInput, Any], PlanInput]
    whole: bool = False


def motion_holds(plan: Plan) -> bool:
    """All but bus load and speed."""
    return all(margin.holds for margin in plan.margins if margin.limited in MOTION)


# What a change does.


def _each(change: Callable[[PlannedModule], PlannedModule]) -> Callable[[PlanInput, Any], PlanInput]:
    """The same change of every module."""
    return lambda given, value: replace(given, modules=tuple(change(module) for module in given.modules))


def _set(place: od.Multiplexer) -> Callable[[PlanInput, Any], PlanInput]:
    """The value in this object of every module."""
    return lambda given, value: _each(lambda module: module.with_values({place: value}))(given, value)


def _limit(given: PlanInput, limit_cycles: float) -> PlanInput:
    return _set(od.SUPERVISION_RESIDUAL_LIMIT)(given, int(limit_cycles * LIMIT_UNITS))


def _motion(field: str, per_unit: float = 1.0, **fields: Any) -> Callable[[PlanInput, Any], PlanInput]:
    """Another motion of the machine; ``per_unit``: of the value in what the field has."""
    return lambda given, value: replace(
        given, motion=replace(given.motion, **{field: value * per_unit}, **fields)
    )


def _bit_rate(given: PlanInput, bit_rate: int) -> PlanInput:
    """The frames of other nodes are as many, and each takes less time."""
    return replace(given, bit_rate=bit_rate, extra_load=given.extra_load * given.bit_rate / bit_rate)


def _rates(given: PlanInput, value: tuple[float, str, int]) -> PlanInput:
    rate_hz, _, bit_rate = value
    return _bit_rate(replace(given, sync_hz=rate_hz), bit_rate)


def _with_samples(given: PlanInput, per_sync: int) -> PlanInput:
    return _each(lambda one: one.with_samples(max(per_sync, one.samples_per_sync)))(given, None)


def _noise_margin(module: PlannedModule) -> PlannedModule:
    """Where nothing else is set."""
    return module if module.noise_margin else module.with_values({od.SUPERVISION_NOISE_MARGIN: NOISE_MARGIN})


_table = _each(lambda module: replace(module, has_table=True))


# Which values are tried.


def _if(holds: Callable[[ChangeCase], bool]) -> Callable[[ChangeCase], Iterable[Any]]:
    """A change without a value."""
    return lambda case: [""] * holds(case)


def _higher_bit_rates(case: ChangeCase) -> Iterator[int]:
    return (bit_rate for bit_rate in BIT_RATES if bit_rate > case.given.bit_rate)


def _lower_rate(case: ChangeCase) -> Iterator[float]:
    """In two or three figures, rounded down."""
    rate_hz = LEAVES * case.given.bus.largest_sync_hz
    if rate_hz > 0.0:
        unit = 10.0 ** (math.floor(math.log10(rate_hz)) - 1)
        yield math.floor(rate_hz / unit + 1e-9) * unit


def _fewer_modules(case: ChangeCase) -> Iterator[tuple[int, int]]:
    return ((count, len(case.modules)) for count in range(len(case.modules) - 1, 0, -1))


def _no_table(case: ChangeCase) -> bool:
    return case.given.errors.phase_cycles is None and not all(module.has_table for module in case.modules)


def _jitter_us(case: ChangeCase) -> Iterator[float]:
    """The largest speed goes with 1/u: so much smaller the uncertainty has to be."""
    budget, speed = case.budget, case.given.motion.speed_rad_s or 0.0
    by_jitter = not budget.module.times and budget.module.samples_per_sync == 1
    if budget.largest_speed_rad_s > 0.0 and by_jitter:
        allowed_s = LEAVES * budget.uncertainty_s * budget.largest_speed_rad_s / speed
        jitter_s = allowed_s - (budget.uncertainty_s - case.given.jitter_s)
        if jitter_s > 0.0:
            yield jitter_s * 1e6


def _below(value: float | None, smaller: float) -> list[float]:
    return [smaller] if 0.0 < smaller < (value or 0.0) else []


def _needed_limit(case: ChangeCase) -> float:
    """Above what is needed, in thousandths: 2010:01 rounds down by 1/65536."""
    needed = max(budget.needed_cycles for budget in case.plan.budgets)
    return math.floor(min(needed, 1.0) * 1000.0 + 1.1) / 1000.0


def _wider_limit(case: ChangeCase) -> Iterator[float]:
    limit = _needed_limit(case)
    if case.budget.module.widest_limit_cycles < limit <= RESIDUAL_LIMIT:
        yield limit


def _more_samples(case: ChangeCase) -> Iterator[tuple[str, int, str]]:
    """More samples for each SYNC, with what they cost."""
    given = case.given
    if all(module.samples_itself for module in case.modules):
        return
    for per_sync in range(min(one.samples_per_sync for one in case.modules) + 1, MOST_PER_SYNC + 1):
        try:
            after = _with_samples(given, per_sync)
        except ValueError:  # no RPDO is left
            return
        more = sum(one.sample_bytes for one in after.modules) - sum(one.sample_bytes for one in case.modules)
        load = 100.0 * (after.bus.load - given.bus.load)
        cost = f"{more} bytes more for each SYNC, bus load +{load:.1f} %"
        yield NUMBERS[per_sync], per_sync, cost


def _faster(case: ChangeCase) -> Iterator[tuple[float, str, int]]:
    """A higher SYNC rate; with a higher bit rate, if the bus does not carry it."""
    given = case.given
    rate_hz = max(budget.least_sync_hz for budget in case.plan.budgets)
    if math.isinf(rate_hz):
        return
    rate_hz = max(rate_hz, given.sync_hz * 1.01)
    for _ in range(MOST_FASTER):
        rounded = float(rounded_up(rate_hz))
        margins = Plan(replace(given, sync_hz=rounded)).margins
        if all(margin.holds for margin in margins if margin.limited is not Limited.BUS):
            yield rounded, "", given.bit_rate
            for bit_rate in _higher_bit_rates(case):
                yield rounded, f", and the bit rate to {bit_rate} bit/s", bit_rate
            return
        rate_hz *= FASTER


def _exceeded(case: ChangeCase) -> Iterator[float]:
    """The acceleration, where the module knows a smaller one."""
    asked = case.budget.asked_rad_s2 or 0.0
    if 0.0 < case.budget.module.known_acceleration_rad_s2 < asked:
        yield asked


def asked_acceleration(plan: Plan) -> float:
    """The largest one, rad/s^2; 0.0: not given."""
    return max(budget.asked_rad_s2 or 0.0 for budget in plan.budgets)


def _unknown_motion(case: ChangeCase) -> Iterator[tuple[float, float]]:
    """The acceleration that a module does not know, or not well; and the residual limit with it."""
    asked = asked_acceleration(case.plan)
    if not all(0.0 < one.known_acceleration_rad_s2 <= KNOWN_ENOUGH * asked for one in case.modules):
        yield asked, widest_limit(Plan(_set(od.SUPERVISION_ACCELERATION)(case.given, asked)))


def _narrower_limit(case: ChangeCase) -> Iterator[float]:
    limit = _needed_limit(case)
    if limit <= RESIDUAL_LIMIT and not any(module.known_acceleration_rad_s2 for module in case.modules):
        yield limit


def _narrowed_by_noise(case: ChangeCase) -> Iterator[float]:
    if all(module.known_acceleration_rad_s2 for module in case.modules):
        yield widest_limit(Plan(_each(_noise_margin)(case.given, None)))


def _sharp_rate(case: ChangeCase) -> Iterator[float]:
    """The rate at which motion + margin + motion is sharp: the limit follows the rate."""
    if not all(module.known_acceleration_rad_s2 for module in case.modules):
        return
    declared = max(module.declared_phase_error_cycles for module in case.modules)
    least = (WELL - WEIGHTS * declared) / 2.0 * LEAVES
    taken = max(budget.motion_part.cycles for budget in case.plan.budgets)
    if taken > least:
        yield float(rounded_up(case.given.sync_hz * math.sqrt(taken / least)))


def is_sharp(plan: Plan) -> bool:
    """Its detection, for every module."""
    return all(plan.detection(budget).is_sharp for budget in plan.budgets)


def widest_limit(plan: Plan) -> float:
    """The largest residual limit in force, cycles."""
    return max(budget.limit_cycles for budget in plan.budgets)


# The table.

_TIMES = ChangeRow(
    "send sample times with the ADC PDO (times: true)",
    _if(lambda case: not all(module.times for module in case.modules)),
    _each(lambda module: module.with_times()),
)
_TABLE = ChangeRow("measure the correction table (canfb calibrate)", _if(_no_table), _table)

_OF_THE_BUS = (
    ChangeRow("raise the bit rate to {} bit/s", _higher_bit_rates, _bit_rate),
    ChangeRow("lower the SYNC rate to {:g} Hz", _lower_rate, lambda given, hz: replace(given, sync_hz=hz)),
    ChangeRow(
        "{} of the {} modules fit on this bus: give the others a second one",
        _fewer_modules,
        lambda given, value: replace(given, modules=given.modules[: value[0]]),
    ),
    ChangeRow(
        "other nodes leave no room: move them to another bus",
        _if(lambda case: True),
        lambda given, _: replace(given, extra_load=0.0),
    ),
)
_OF_THE_SPEED = (
    _TIMES,
    _TABLE,
    ChangeRow(
        "lower the jitter of the SYNC to ±{:.3g} µs",
        _jitter_us,
        lambda given, us: replace(given, jitter_s=us * 1e-6),
    ),
    ChangeRow(
        "turn at {:.4g} rpm at most",
        lambda case: _below(math.inf, case.least(lambda budget: budget.largest_speed_rad_s * RPM)),
        _motion("speed_rad_s", 1.0 / RPM),
    ),
)
_OF_THE_MOTION = (
    _TIMES,
    ChangeRow(
        "set max_acceleration_rad_s2 (2010:02) to {:.4g}, which is what the motion needs",
        _exceeded,
        _set(od.SUPERVISION_ACCELERATION),
    ),
    ChangeRow("raise residual_limit (2010:01) to {:.3f} cycle", _wider_limit, _limit),
    _TABLE,
    ChangeRow("raise the SYNC rate to {:g} Hz{}", _faster, _rates),
    ChangeRow(
        "send {} samples for each SYNC (samples_per_sync: {}; {}): that holds this move",
        _more_samples,
        lambda given, value: _with_samples(given, value[1]),
        whole=True,
    ),
    ChangeRow(
        "accelerate by {:.4g} rad/s^2 at most",
        lambda case: _below(
            case.budget.asked_rad_s2, case.least(lambda budget: budget.largest_acceleration_rad_s2)
        ),
        _motion("acceleration_rad_s2", is_final=True),
    ),
    ChangeRow(
        "average the tracks, or raise their amplitude: their noise alone exceeds the limit",
        _if(lambda case: True),
        lambda given, _: replace(given, errors=replace(given.errors, noise_counts=0.0)),
    ),
)
CHANGES = {Limited.BUS: _OF_THE_BUS, Limited.SPEED: _OF_THE_SPEED, **dict.fromkeys(MOTION, _OF_THE_MOTION)}
NARROWER = (
    ChangeRow(
        "set max_acceleration_rad_s2 (2010:02) to {:.6g}: the residual limit becomes {:.3f}",
        _unknown_motion,
        lambda given, value: _set(od.SUPERVISION_ACCELERATION)(given, value[0]),
    ),
    ChangeRow("lower residual_limit (2010:01) to {:.3f} cycle", _narrower_limit, _limit),
)
SHARPER = (
    ChangeRow(
        f"set noise_margin (2010:09) to {NOISE_MARGIN}: the residual limit becomes {{:.3f}}",
        _narrowed_by_noise,
        _each(_noise_margin),
    ),
    ChangeRow(
        "raise the SYNC rate to {:g} Hz", _sharp_rate, lambda given, rate_hz: replace(given, sync_hz=rate_hz)
    ),
)
