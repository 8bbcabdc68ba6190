"""A plan for programs: figures in the units of their names, None for what is not limited or not stated."""

from __future__ import annotations

import math
from typing import Any

from canfb.planning.budget import ResidualBudget, over
from canfb.planning.changes import Remedy
from canfb.planning.detection import CountDetection
from canfb.planning.plan import Plan
from canfb.planning.plan_coverage import coverage_figures

RPM = 60.0 / (2.0 * math.pi)


def plan_figures(plan: Plan, remedies: list[Remedy]) -> dict[str, Any]:
    """What ``canfb plan --json`` prints."""
    tight = plan.tightest
    return {
        "holds": plan.holds,
        "tightest": {
            "limit": tight.limited.value,
            "node_id": None if tight.module is None else tight.module.node_id,
            "margin": _finite(tight.factor),
        },
        "bus": _bus(plan),
        "modules": [_module(plan, budget) for budget in plan.budgets],
        "changes": [{"for": remedy.for_what, "change": remedy.text} for remedy in remedies],
    }


def _bus(plan: Plan) -> dict[str, Any]:
    bus = plan.situation.bus
    return {
        "bit_rate": bus.bit_rate,
        "sync_hz": bus.sync_hz,
        "largest_sync_hz": bus.largest_sync_hz,
        "load": bus.load,
        "margin": _finite(over(1.0, bus.load)),
        "extra_load": bus.extra_load,
        "longest_turn_s": bus.longest_turn_s,
        "sync_delay_s": bus.sync_delay_s,
        "messages": [
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
        ],
    }


def _module(plan: Plan, budget: ResidualBudget) -> dict[str, Any]:
    module, motion = budget.module, plan.situation.motion
    return {
        "node_id": module.node_id,
        "cycles_per_revolution": module.cycles_per_revolution,
        "prediction_order": budget.weights.order,
        "samples_per_sync": module.samples_per_sync,
        "sample_bytes": module.sample_bytes,
        "times": module.times,
        "table": module.has_table,
        "residual_limit_cycles": budget.limit_cycles,
        "noise_margin": module.noise_margin,
        "measured_noise_cycles": _finite(budget.measured_noise_cycles),
        "sync_jitter_s": budget.sync_jitter_s,
        "speed": {
            "stated_rpm": _scaled(motion.speed_rad_s),
            "largest_rpm": _scaled(budget.largest_speed_rad_s),
            "equation_rpm": _scaled(budget.equation_speed_rad_s),
            "margin": _margin(budget.largest_speed_rad_s, motion.speed_rad_s),
        },
        "acceleration": {
            "stated_rad_s2": budget.asked_rad_s2,
            "largest_rad_s2": _finite(budget.largest_acceleration_rad_s2),
            "equation_12_rad_s2": budget.equation_rad_s2,
            "equation_10_rad_s2": budget.paper_rad_s2,
            "least_sync_hz": _finite(budget.least_sync_hz),
            "margin": _margin(budget.largest_acceleration_rad_s2, budget.asked_rad_s2),
        },
        "jerk": {
            "stated_rad_s3": budget.asked_rad_s3,
            "largest_rad_s3": _finite(budget.largest_jerk_rad_s3),
            "equation_rad_s3": _finite(budget.equation_rad_s3),
            "margin": _margin(budget.largest_jerk_rad_s3, budget.asked_rad_s3),
            "within_one_interval_rad_s2": budget.jerk_rad_s2,
            "within_one_interval_cycles": None
            if budget.jerk_rad_s2 is None
            else budget.acceleration_cycles(budget.jerk_rad_s2),
        },
        "residual": {
            "needed_cycles": _finite(budget.needed_cycles),
            "parts_cycles": {part.what: _finite(part.cycles) for part in budget.parts},
            "margin": budget.margin,
        },
        "detection": _detection(plan.detection(budget)),
        "detection_at_needed_limit": _detection(plan.detection(budget, min(budget.needed_cycles, 0.5))),
        "coverage": coverage_figures(plan, budget),
    }


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
            "coast_samples": found.declared.coast_samples,
            "holds": found.is_declared,
        },
        "half_cycle": found.half_cycle,
        "unseen_jump_cycles": found.unseen_jump_cycles,
        "sharp": found.is_sharp,
    }


def _scaled(speed_rad_s: float | None) -> float | None:
    return None if speed_rad_s is None else _finite(speed_rad_s * RPM)


def _margin(limit: float, value: float | None) -> float | None:
    return None if value is None else _finite(over(limit, value))


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
