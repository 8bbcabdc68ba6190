"""A plan for people: the bus as a table, then each module with its margins, and what to change first."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import groupby

from canfb.planning.analog_lines import analog_lines
from canfb.planning.budget import ResidualBudget, over
from canfb.planning.changes import Remedy
from canfb.planning.detection import CountDetection
from canfb.planning.plan import Plan
from canfb.planning.plan_coverage import area_line, coverage_lines
from canfb.planning.situation import Situation
from canfb.planning.traffic import Message
from canfb.signal.limits import CALIBRATED_PHASE_ERROR_CYCLES

RPM = 60.0 / (2.0 * math.pi)
EXCEEDED = "   <- exceeded"
MOST_COASTED = 255


def plan_lines(plan: Plan, remedies: list[Remedy], *, coverage: bool = False) -> list[str]:
    """All of it; ``remedies`` are those of the plan. ``coverage``: with the diagnostic coverage by fault."""
    lines = [*_bus_lines(plan.situation), ""]
    for names, budget in _alike(plan):
        faults = coverage_lines(plan, budget) if coverage else []
        lines += [*_module_lines(plan, names, budget), *faults, ""]
    return [*lines, *_verdict(plan, remedies)]


def _bus_lines(situation: Situation) -> list[str]:
    bus = situation.bus
    lines = [
        f"bus: {bus.bit_rate} bit/s, SYNC {bus.sync_hz:g} Hz; frames with the most stuff bits",
        f"  {'COB-ID':<12}{'frame':<28}{'bytes':>5}{'bits':>6}{'per s':>9}{'load %':>8}",
    ]
    for alike in _alike_messages(bus.messages):
        rate, message = alike[0].rate_hz(bus.sync_hz), alike[0]
        share = 100.0 * len(alike) * message.bits_per_s(bus.sync_hz) / bus.bit_rate
        ids = (".." if len(alike) > 2 else ", ").join(
            dict.fromkeys(f"{one.can_id:03X}h" for one in (message, alike[-1]))
        )
        what = message.what if len(alike) == 1 else f"{message.kind}, {len(alike)} nodes"
        lines.append(
            f"  {ids:<12}{what:<28}{message.data_bytes:>5}{message.bits:>6}{rate:>9.4g}{share:>8.2f}"
        )
    if bus.extra_load:
        lines.append(f"  {'':<12}{'other nodes':<28}{'':>20}{100.0 * bus.extra_load:>8.2f}")
    turn_ms, interval_ms = bus.longest_turn_s * 1e3, 1e3 / bus.sync_hz
    return [
        *lines,
        _line("bus load", f"{100.0 * bus.load:.1f} of 100 %", over(1.0, bus.load)),
        f"  SYNC rate: {bus.sync_hz:g} of {bus.largest_sync_hz:.4g} Hz that the bus carries",
        f"  a turn (SYNC to the last PDO, all at once): {turn_ms:.3g} of {interval_ms:.4g} ms"
        + (" (longer than an interval)" if turn_ms > interval_ms else ""),
    ]


def _alike_messages(messages: Iterable[Message]) -> list[list[Message]]:
    """Neighbours that differ by their node alone share a line."""
    groups = groupby(messages, lambda one: (one.kind, one.data_bytes, one.least_hz, one.most_hz))
    return [list(group) for _, group in groups]


def _module_lines(plan: Plan, names: str, budget: ResidualBudget) -> list[str]:
    module, motion = budget.module, plan.situation.motion
    third = module.is_third_order
    order = "third-order prediction, " if third else ""
    several = f"{module.samples_per_sync} samples per SYNC, " if module.samples_per_sync > 1 else ""
    return [
        f"node{'s' if ',' in names else ''} {names}: {module.cycles_per_revolution} cycles per revolution, "
        f"{several}{order}residual limit {budget.limit_cycles:.3f} cycle{_narrowed(budget)}",
        *([f"  {motion.where}"] if motion.where else []),
        _speed_line(budget, motion.speed_rad_s),
        *analog_lines(module, motion.speed_rad_s),
        f"    {_instants(budget)}",
        *(_third_order_lines(budget) if third else [*_acceleration_lines(budget), *_jerk_lines(budget)]),
        _line("residual", f"{budget.needed_cycles:.3f} of {budget.limit_cycles:.3f} cycle", budget.margin),
        "    " + " + ".join(f"{part.what} {part.cycles:.3f}" for part in budget.parts),
        *_detection_lines(plan.detection(budget), budget),
        area_line(plan, budget),
    ]


def _narrowed(budget: ResidualBudget) -> str:
    if not budget.is_narrowed:
        return ""
    known = "2010:08" if budget.module.is_third_order else "2010:02"
    return f", narrowed by {known}{' and 2010:09' if budget.has_noise_margin else ''}"


def _speed_line(budget: ResidualBudget, stated: float | None) -> str:
    largest = budget.largest_speed_rad_s
    allowed = "no limit" if math.isinf(largest) else f"{largest * RPM:.4g} rpm"
    if stated is None:
        return f"  speed: {allowed}"
    if math.isinf(largest):
        return f"  speed: {stated * RPM:.4g} rpm, {allowed}"
    return _line("speed", f"{stated * RPM:.4g} of {allowed}", over(largest, stated))


def _instants(budget: ResidualBudget) -> str:
    if budget.module.samples_itself:
        return "the module samples itself: the jitter of SYNC does not matter"
    if budget.module.times:
        return "sample times: the jitter of SYNC does not limit the speed"
    if budget.module.samples_per_sync > 1:
        return "the interface samples by its own timer: the jitter of SYNC does not limit the speed"
    bus_us, own_us = budget.situation.bus.sync_delay_s / 2.0 * 1e6, budget.situation.jitter_s * 1e6
    said = f"no sample times; SYNC ±{own_us + bus_us:.3g} µs"
    return f"{said}: producer {own_us:.3g}, frames before it {bus_us:.3g}"


def _acceleration_lines(budget: ResidualBudget) -> list[str]:
    largest, stated = budget.largest_acceleration_rad_s2, budget.asked_rad_s2
    equations = f"    eq. 12 alone allows {budget.equation_rad_s2:.4g}, eq. 10 {budget.paper_rad_s2:.4g}"
    if stated is None:
        return [f"  acceleration: {largest:.4g} rad/s^2", equations]
    line = _line("acceleration", f"{stated:.4g} of {largest:.4g} rad/s^2", over(largest, stated))
    least = budget.least_sync_hz
    needs = "no SYNC rate is enough" if math.isinf(least) else f"a SYNC of {least:.4g} Hz or more is needed"
    return [line, f"{equations}; {needs}" if stated else equations]


def _jerk_lines(budget: ResidualBudget) -> list[str]:
    changed, jerk = budget.jerk_rad_s2, budget.asked_rad_s3
    if changed is None or jerk is None:
        return []
    cycles = budget.acceleration_cycles(changed)
    return [
        f"  jerk: {jerk:.4g} rad/s^3, in one interval {changed:.4g} rad/s^2 or {cycles:.3f} cycle "
        "(eq. 9 does not use it)"
    ]


def _third_order_lines(budget: ResidualBudget) -> list[str]:
    """Acceleration and jerk, where the jerk is what the prediction limits."""
    largest, stated, jerk = budget.largest_acceleration_rad_s2, budget.asked_rad_s2, budget.asked_rad_s3
    least = budget.least_sync_hz
    needs = "no SYNC rate is enough" if math.isinf(least) else f"a SYNC of {least:.4g} Hz or more is needed"
    allowed = "no limit" if math.isinf(largest) else f"{largest:.4g} rad/s^2"
    step = "    no jerk is stated: the acceleration steps from 0 in one interval"
    if stated is None:
        lines = [f"  acceleration: {allowed}"]
    elif math.isinf(largest):
        lines = [f"  acceleration: {stated:.4g} rad/s^2, {allowed}"]
    else:
        lines = [_line("acceleration", f"{stated:.4g} of {allowed}", over(largest, stated))]
    lines += [f"{step}; {needs}" if stated else step] if jerk is None else []
    most = f"{budget.largest_jerk_rad_s3:.6g} rad/s^3"
    equation = f"    third-order prediction alone allows {budget.equation_rad_s3:.6g}"
    if jerk is None:
        return [*lines, f"  jerk: {most}", equation]
    line = _line("jerk", f"{jerk:.6g} of {most}", over(budget.largest_jerk_rad_s3, jerk))
    return [*lines, line, f"{equation}; {needs}" if jerk else equation]


def _detection_lines(found: CountDetection, budget: ResidualBudget) -> list[str]:
    module = budget.module
    frozen = f"after {module.frozen_samples} equal samples" if module.frozen_samples else "not looked for"
    half = "always" if found.half_cycle else "not always"
    motion, well = ("j", "1/4") if module.is_third_order else ("a", "1/6")
    return [
        f"  detection (docs/faults.md): L + {motion} = {found.limit_cycles + found.motion_cycles:.3f} cycle, "
        + (f"at most {well}: sharp" if found.is_sharp else f"above {well}: weak"),
        f"    bad samples in a row that cannot change the count unseen: {found.bad_samples}",
        *_kept_lines(found, budget),
        f"    a jump of half a cycle is seen {half}; one below {found.unseen_jump_cycles:.3f} cycle may pass",
        f"    amplitude limits {_amplitude(budget)}; frozen input: {frozen}",
    ]


def _kept_lines(found: CountDetection, budget: ResidualBudget) -> list[str]:
    """What is bridged for certain with what is declared, and what other declarations would bridge."""
    declared, third = found.declared, budget.module.is_third_order
    known = declared.jerk if third else declared.acceleration
    power, place = ("³", "2010:08") if third else ("²", "2010:02")
    if known is not None:
        followed = f"{place} {declared.followed:.3g} cycle per interval{power}"
    else:
        source = "by the residual limit" if third or not declared.assumes else "2010:0B"
        followed = f"{place} not set, {declared.followed:.3g} cycle per interval{power} assumed, {source}"
    kept = found.missed_samples
    lines = [
        "    missed or flagged samples in a row after which the position is certain: "
        f"{kept}, at most {budget.module.coast_samples} (2010:03)",
        f"      declared: {followed}; phase error {declared.phase_error:.3g} cycle (2010:0C); "
        f"up to {declared.bad_samples} bad unnoticed (2010:0A)",
    ]
    if not found.is_declared:
        lines.append(
            f"      the motion is larger: after a gap a position can be valid and wrong; set {place}"
        )
    motion = "jerk" if third else "acceleration"
    choices: dict[str, dict[str, float]] = {
        f"{place} for the motion of this plan": {motion: found.motion_cycles} if known is None else {},
        f"a phase error of {CALIBRATED_PHASE_ERROR_CYCLES:g}, as after canfb calibrate": {
            "phase_error": min(declared.phase_error, CALIBRATED_PHASE_ERROR_CYCLES)
        },
        "a larger 2010:03": {"coast_samples": MOST_COASTED},
    }
    for words, change in choices.items():
        if change and found.motion_cycles and (other := found.kept_with(**change)) != kept:
            lines.append(f"      {other} with {words}")
    return lines


def _amplitude(budget: ResidualBudget) -> str:
    low, high = budget.module.amplitude_limits_counts
    nominal = budget.situation.errors.amplitude * budget.module.full_scale_counts
    return f"{low / nominal:.2g} to {high / nominal:.2g} of nominal" if nominal else f"{low} to {high} counts"


def _verdict(plan: Plan, remedies: list[Remedy]) -> list[str]:
    tight = plan.tightest
    which = "" if tight.module is None or len(plan.budgets) == 1 else f" of node {tight.module.node_id:02X}h"
    said = "the plan holds" if plan.holds else "the plan does NOT hold"
    lines = [f"{said}; tightest: {tight.limited}{which}, margin {_factor(tight.factor)}"]
    if not remedies:
        lines.append("nothing to change" if plan.holds else "no single change helps")
    for n, remedy in enumerate(remedies):
        lines.append(f"{'first' if n == 0 else 'then'}, for {remedy.for_what}: {remedy.text}")
    last = Plan(remedies[-1].situation) if remedies else plan
    if remedies and not last.holds:
        lines.append(f"still exceeded then: {last.tightest.limited}, margin {_factor(last.tightest.factor)}")
    return lines


def _alike(plan: Plan) -> list[tuple[str, ResidualBudget]]:
    """Modules that differ by their node-ID alone share their lines."""
    found: dict[tuple[object, ...], tuple[list[str], ResidualBudget]] = {}
    for budget in plan.budgets:
        module = budget.module
        low_high, frozen = module.amplitude_limits_counts, module.frozen_samples
        key = (module.cycles_per_revolution, module.times, module.has_table, module.samples_itself, low_high,
               frozen, module.is_third_order, module.samples_per_sync, budget.limit_cycles,
               budget.needed_cycles, module.full_scale_counts)  # fmt: skip
        found.setdefault(key, ([], budget))[0].append(f"{module.node_id:02X}h")
    return [(", ".join(names), budget) for names, budget in found.values()]


def _line(what: str, figures: str, factor: float) -> str:
    return f"  {what}: {figures}, margin {_factor(factor)}{'' if factor >= 1.0 else EXCEEDED}"


def _factor(factor: float) -> str:
    """Rounded down, so that 0.999 is not shown as 1.0."""
    if math.isinf(factor):
        return "unlimited"
    digits = 2 if factor < 2.0 else 1
    return f"{math.floor(factor * 10**digits + 1e-6) / 10**digits:.{digits}f}"
