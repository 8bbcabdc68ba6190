"""A plan as text and JSON: the bus as a table, each module with its margins, what to change first.

The rows of a module are printed, named ones as ``name: words``, all others below them, and give its JSON:
figures in the units of their keys, null without limit or value.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import groupby
from typing import Any

from canfb import objects as od
from canfb.planning.coverage import (
    CASES,
    FAULTY_SAMPLES,
    USUAL_TOLERANCE,
    area_coverage,
    fault_coverage,
    second_tolerance,
    window_of,
)
from canfb.planning.hints import PlanChange
from canfb.planning.plan import RPM, CountDetection, Limited, Plan, ResidualBudget, over
from canfb.planning.planned_bus import BusLoad, Message, PlannedModule
from canfb.rows import Row, as_figures, finite, those
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.front_end import LARGEST_RAD, FrontEnd
from canfb.signal.limits import CALIBRATED_PHASE_ERROR_CYCLES, MOST_IN_A_ROW

EXCEEDED = "   <- exceeded"


def plan_figures(plan: Plan, changes: list[PlanChange]) -> dict[str, Any]:
    tight = plan.tightest
    return {
        "holds": plan.holds,
        "tightest": {
            "limit": tight.limited.value,
            "node_id": None if tight.module is None else tight.module.node_id,
            "margin": finite(tight.factor),
        },
        "bus": as_figures(_bus_rows(plan.bus)),
        "modules": [as_figures(_module_rows(budget), coverage_rows(budget)) for budget in plan.budgets],
        "changes": [{"for": one.for_what, "change": one.text} for one in changes],
    }


def plan_lines(plan: Plan, changes: list[PlanChange], *, coverage: bool = False) -> list[str]:
    alike: dict[tuple[str, ...], list[str]] = {}  # modules that differ only in their node-ID share lines
    for budget in plan.budgets:
        rows = _module_rows(budget) + (coverage_rows(budget) if coverage else [])
        alike.setdefault((*_heading(budget), *_as_lines(rows)), []).append(f"{budget.module.node_id:02X}h")
    lines = [*_frame_lines(plan.bus), *_as_lines(_bus_rows(plan.bus)), ""]
    for (heading, *rest), nodes in alike.items():
        lines += [f"node{'s' * (len(nodes) > 1)} {', '.join(nodes)}: {heading}", *rest, ""]
    return [*lines, *_verdict(plan, changes)]


def _as_lines(rows: Iterable[Row]) -> list[str]:
    shown = [(row.name, word) for row in rows for word in row.words]
    return [f"  {name}: {word}".removesuffix(": ") if name else f"    {word}" for name, word in shown]


def _margin_row(name: str, words: str, factor: float, **figures: Any) -> Row:
    return Row(name, f"{words}, margin {_factor(factor)}{'' if factor >= 1.0 else EXCEEDED}", **figures)


def _factor(factor: float) -> str:
    if math.isinf(factor):
        return "unlimited"
    digits = 2 if factor < 2.0 else 1
    return f"{math.floor(factor * 10**digits + 1e-6) / 10**digits:.{digits}f}"


# The bus.


def _frame_lines(bus: BusLoad) -> list[str]:
    lines = [
        f"bus: {bus.bit_rate} bit/s, SYNC {bus.sync_hz:g} Hz; frames with the most stuff bits",
        f"  {'COB-ID':<12}{'frame':<28}{'bytes':>5}{'bits':>6}{'per s':>9}{'load %':>8}",
    ]
    for _, group in groupby(bus.messages, lambda one: (one.kind, one.data_bytes, one.least_hz, one.most_hz)):
        alike: list[Message] = list(group)
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
    return lines


def _bus_rows(bus: BusLoad) -> list[Row]:
    turn_ms, interval_ms, margin = bus.longest_turn_s * 1e3, 1e3 / bus.sync_hz, over(1.0, bus.load)
    longer = " (longer than an interval)" if turn_ms > interval_ms else ""
    return [
        Row(bit_rate=bus.bit_rate, extra_load=bus.extra_load, sync_delay_s=bus.sync_delay_s),
        _margin_row(
            "bus load",
            f"{100.0 * bus.load:.1f} of 100 %",
            margin,
            load=bus.load,
            margin=finite(margin),
        ),
        Row(
            "SYNC rate",
            f"{bus.sync_hz:g} of {bus.largest_sync_hz:.4g} Hz that the bus carries",
            sync_hz=bus.sync_hz,
            largest_sync_hz=bus.largest_sync_hz,
        ),
        Row(
            "a turn (SYNC to the last PDO, all at once)",
            f"{turn_ms:.3g} of {interval_ms:.4g} ms{longer}",
            longest_turn_s=bus.longest_turn_s,
        ),
        Row(
            messages=[
                {
                    "cob_id": message.can_id,
                    "what": message.what,
                    "node_id": message.node_id,
                    "bytes": message.data_bytes,
                    "bits": message.bits,
                    "rate_hz": message.rate_hz(bus.sync_hz),
                    "load": message.bits_per_s(bus.sync_hz) / bus.bit_rate,
                    "follows_sync": message.follows_sync(bus.sync_hz),
                }
                for message in bus.messages
            ]
        ),
    ]


# A module.


def _heading(budget: ResidualBudget) -> list[str]:
    settings, where = budget.module.settings, budget.plan.where
    several = f"{settings.samples_per_sync} samples per SYNC, " if settings.samples_per_sync > 1 else ""
    by = "2010:02 and 2010:09" if budget.has_noise_margin else "2010:02"
    narrowed = f", narrowed by {by}" if budget.is_narrowed else ""
    return [
        f"{settings.cycles_per_revolution} cycles per revolution, {several}residual limit "
        f"{budget.limit_cycles:.3f} cycle{narrowed}",
        *([f"  {where}"] if where else []),
    ]


def _module_rows(budget: ResidualBudget) -> list[Row]:
    module, speed, largest = budget.module, budget.plan.speed_rad_s, budget.largest_speed_rad_s
    speed_figures = {
        "stated_rpm": None if speed is None else finite(speed * RPM),
        "largest_rpm": finite(largest * RPM),
        "equation_rpm": finite(budget.equation_speed_rad_s * RPM),
        "margin": finite(budget.margins.get(Limited.SPEED, math.inf)),
    }
    return [
        Row(
            node_id=module.node_id,
            cycles_per_revolution=module.settings.cycles_per_revolution,
            samples_per_sync=module.settings.samples_per_sync,
            sample_bytes=module.sample_bytes,
            times=module.times,
            table=module.has_table,
            residual_limit_cycles=budget.limit_cycles,
            noise_margin=module.settings.noise_margin,
            measured_noise_cycles=finite(budget.measured_noise_cycles),
            sync_jitter_s=budget.sync_jitter_s,
        ),
        _limited_row("speed", "rpm", speed and speed * RPM, largest * RPM, speed=speed_figures),
        analog_row(module, speed),
        Row("", _instants(budget)),
        *_motion_rows(budget),
        _margin_row(
            "residual",
            f"{budget.needed_cycles:.3f} of {budget.limit_cycles:.3f} cycle",
            budget.margins[Limited.RESIDUAL],
            residual={
                "needed_cycles": finite(budget.needed_cycles),
                "parts_cycles": {what: finite(cycles) for what, cycles in budget.parts_cycles.items()},
                "margin": budget.margins[Limited.RESIDUAL],
            },
        ),
        Row("", " + ".join(f"{what} {cycles:.3f}" for what, cycles in budget.parts_cycles.items())),
        *_detection_rows(budget),
    ]


def _limited_row(name: str, unit: str, given: float | None, largest: float, **figures: Any) -> Row:
    allowed = "no limit" if math.isinf(largest) else f"{largest:.4g} {unit}"
    if given is None or math.isinf(largest):
        return Row(name, allowed if given is None else f"{given:.4g} {unit}, {allowed}", **figures)
    return _margin_row(name, f"{given:.4g} of {allowed}", over(largest, given), **figures)


def analog_row(module: PlannedModule, speed_rad_s: float | None) -> Row:
    """The analog path at the largest speed (2002:06, 2002:07, 2001:05); no words if it is not known."""
    hertz = (speed_rad_s or 0.0) * module.settings.cycles_per_revolution / (2.0 * math.pi)
    pairs = zip(od.CONDITIONING, IDENTITY.values, strict=True)
    used = Conditioning(*(float(module.values.get(place, default)) for place, default in pairs))
    corners = module.settings.corners
    front = FrontEnd(used, corners)
    front.use_interval(1.0)
    turned, corner_hz = front.turned_rad(hertz), corners.corner_hz
    exceeded = abs(turned) + abs(used.phase_error_rad) >= LARGEST_RAD
    left = 1.0 / math.hypot(1.0, hertz / corner_hz) if corner_hz else 1.0
    parts = those(
        (turned, f"{turned / (2.0 * math.pi):+.3f} cycle between the tracks, removed"),
        (corner_hz, f"{100.0 * left:.0f} % of the amplitude left"),
        (
            used.delay_s,
            f"{front.lag_intervals(hertz) * hertz:+.3f} cycle of delay, added to the position",
        ),
    )
    words = f"analog path at {hertz / 1e3:.4g} kHz: {'; '.join(parts)}{EXCEEDED * exceeded}"
    return Row("", words if parts and hertz else None)


def _instants(budget: ResidualBudget) -> str:
    if budget.module.samples_itself:
        return "the module samples itself: the jitter of SYNC does not matter"
    if budget.module.times:
        return "sample times: the jitter of SYNC does not limit the speed"
    if budget.module.settings.samples_per_sync > 1:
        return (
            "the interface samples by its own timer; without times a SYNC early by more than 20 µs plus 0.3 "
            "of the answer delay costs its sample in motion"
        )
    bus_us, own_us = budget.plan.bus.sync_delay_s / 2.0 * 1e6, budget.plan.jitter_s * 1e6
    parts = f"producer {own_us:.3g}, frames before it {bus_us:.3g}"
    said = f"no sample times; SYNC ±{own_us + bus_us:.3g} µs: {parts}"
    declared_us = budget.module.settings.sync_jitter_s * 1e6
    return f"{said}; declared ±{declared_us:.3g} µs" if declared_us else said


def _motion_rows(budget: ResidualBudget) -> list[Row]:
    asked, largest, least = budget.asked_rad_s2, budget.largest_acceleration_rad_s2, budget.least_sync_hz
    needs = "no SYNC rate is enough" if math.isinf(least) else f"a SYNC of {least:.4g} Hz or more is needed"
    acceleration = {
        "stated_rad_s2": asked,
        "largest_rad_s2": finite(largest),
        "equation_12_rad_s2": budget.equation_rad_s2,
        "equation_10_rad_s2": budget.paper_rad_s2,
        "least_sync_hz": finite(least),
        "margin": finite(budget.margins.get(Limited.ACCELERATION, math.inf)),
    }
    equations = f"eq. 12 alone allows {budget.equation_rad_s2:.4g}, eq. 10 {budget.paper_rad_s2:.4g}"
    return [
        _limited_row("acceleration", "rad/s^2", asked, largest, acceleration=acceleration),
        Row("", f"{equations}; {needs}" if asked else equations),
    ]


# What is detected.


def _detection_rows(budget: ResidualBudget) -> list[Row]:
    found, module = budget.detection(), budget.module
    equal, sample = module.settings.frozen_samples, module.settings.sample
    frozen = f"after {equal} equal samples" if equal else "not checked"
    half = "always" if found.half_cycle else "not always"
    low, high = sample.amplitude_low_counts, sample.amplitude_high_counts
    nominal = budget.plan.amplitude * sample.full_scale_counts
    amplitude = (
        f"{low / nominal:.2g} to {high / nominal:.2g} of nominal" if nominal else f"{low} to {high} counts"
    )
    area = area_coverage(window_of(budget))
    return [
        Row(
            "detection (docs/supervision.md)",
            f"L + a = {found.limit_cycles + found.motion_cycles:.3f} cycle, "
            + ("at most 1/6: sharp" if found.is_sharp else "above 1/6: weak"),
            detection=_detection(found),
            detection_at_needed_limit=_detection(budget.detection(min(budget.needed_cycles, 0.5))),
        ),
        Row("", f"bad samples in a row that cannot change the count unseen: {found.bad_samples}"),
        *(Row("", words) for words in _kept_words(found, budget)),
        Row(
            "",
            f"a jump of half a cycle is {half} detected; one below {found.limit_cycles:.3f} cycle may pass",
        ),
        Row("", f"amplitude limits {amplitude}; frozen input: {frozen}"),
        Row(
            "",
            "coverage of any voltages (1 - allowed area / whole area): "
            f"{_percent(area.amplitude)} by the amplitude, {_percent(area.residual)} with the residual",
        ),
    ]


def _detection(found: CountDetection) -> dict[str, Any]:
    return {
        "limit_cycles": found.limit_cycles,
        "limit_and_motion_cycles": found.limit_cycles + found.motion_cycles,
        "bad_samples": found.bad_samples,
        "missed_samples": found.missed_samples,
        "declared": {
            "cycles_per_interval_to_the_order": found.declared.followed,
            "phase_error_cycles": found.declared.phase_error,
            "bad_samples": found.declared.bad_samples,
            "coast_samples": found.declared.coasting,
            "holds": found.is_declared,
        },
        "half_cycle": found.half_cycle,
        "unseen_jump_cycles": found.limit_cycles,
        "sharp": found.is_sharp,
    }


def _kept_words(found: CountDetection, budget: ResidualBudget) -> list[str]:
    declared = found.declared
    known = declared.acceleration
    followed = f"2010:02 {declared.followed:.3g} cycle per interval²"
    if known is None:
        source = "2010:0B" if declared.assumes else "by the residual limit"
        followed = f"2010:02 not set, {declared.followed:.3g} cycle per interval² assumed, {source}"
    kept, moves = found.missed_samples, found.motion_cycles > 0.0
    with_motion = found.kept_with(acceleration=found.motion_cycles) if moves and known is None else kept
    others = {
        "2010:02 for the motion of this plan": with_motion,
        f"a phase error of {CALIBRATED_PHASE_ERROR_CYCLES:g}, as after canfb calibrate": found.kept_with(
            phase_error=min(declared.phase_error, CALIBRATED_PHASE_ERROR_CYCLES)
        ),
        "a larger 2010:03": found.kept_with(coast_samples=MOST_IN_A_ROW),
    }
    return [
        "missed or flagged samples in a row after which the position is certain: "
        f"{kept}, at most {declared.coasting} (2010:03)",
        f"  declared: {followed}; phase error {declared.phase_error:.3g} cycle (2010:0C); "
        f"up to {declared.bad_samples} bad unnoticed (2010:0A)",
        *those(
            (
                not found.is_declared,
                "  exceeded: after a gap a position can be valid and wrong; set 2010:02, 2010:0C",
            ),
            *((moves and other != kept, f"  {other} with {words}") for words, other in others.items()),
        ),
    ]


def coverage_rows(budget: ResidualBudget) -> list[Row]:
    window, tolerance = window_of(budget), second_tolerance(budget)
    within, mapped = (USUAL_TOLERANCE, "none is mapped") if tolerance is None else (tolerance, "2014:04")
    found, of_samples = fault_coverage(window), f"{CASES} faults each of {FAULTY_SAMPLES} samples"
    return [
        Row(f"diagnostic coverage in motion, {of_samples}, no certificate", ""),
        Row(
            "",
            f"(docs/evidence.md); second position within {within:g} revolution ({mapped})",
        ),
        Row("", f"{'fault':<26}{'amplitude':>10}{'+ residual':>12}{'+ second':>10}{'99 % within':>20}"),
        *(
            Row(
                "",
                f"{one.name:<26}{_percent(one.shares.amplitude):>10}{_percent(one.shares.residual):>12}"
                f"{_percent(one.shares.second_position):>10}{_time(one.within, budget):>20}",
            )
            for one in found
        ),
        Row(
            coverage={
                "any_voltages": area_coverage(window)._asdict(),
                "second_position_cycles": window.tolerance_cycles,
                "second_position_mapped": tolerance is not None,
                "faults": {
                    one.name: {
                        **one.shares._asdict(),
                        "harmful": one.harmful / CASES,
                        "within_s": None if one.within is None else one.within * budget.interval_s,
                    }
                    for one in found
                },
            }
        ),
    ]


def _time(within: int | None, budget: ResidualBudget) -> str:
    if within is None:
        return "-"
    samples = "sample" if within == 1 else "samples"
    return f"{within} {samples}, {within * budget.interval_s * 1e3:.3g} ms"


def _percent(part: float) -> str:
    return f"{int(1000.0 * part + 1e-9) / 10.0:.1f} %"


# The verdict.


def _verdict(plan: Plan, changes: list[PlanChange]) -> list[str]:
    tight = plan.tightest
    which = "" if tight.module is None or len(plan.budgets) == 1 else f" of node {tight.module.node_id:02X}h"
    said = "the plan holds" if plan.holds else "the plan does NOT hold"
    last = changes[-1].plan if changes else plan
    nothing = "nothing to change" if plan.holds else "no single change helps"
    left = f"{last.tightest.limited}, margin {_factor(last.tightest.factor)}"
    return [
        f"{said}; tightest: {tight.limited}{which}, margin {_factor(tight.factor)}",
        *(f"{'then' if n else 'first'}, for {one.for_what}: {one.text}" for n, one in enumerate(changes)),
        *those((not changes, nothing), (changes and not last.holds, f"still exceeded then: {left}")),
    ]
