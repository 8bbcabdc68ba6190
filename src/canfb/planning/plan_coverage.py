"""Diagnostic coverage of a planned module, for people and for programs."""

from __future__ import annotations

from typing import Any

from canfb import objects as od
from canfb.planning.budget import ResidualBudget
from canfb.planning.coverage import CASES, FAULTY_SAMPLES, FaultCoverage, SampleWindow, Shares
from canfb.planning.coverage import area_coverage as area_coverage_of
from canfb.planning.coverage import fault_coverage as fault_coverage_of
from canfb.planning.plan import Plan
from canfb.signal.third_order import THIRD
from canfb.view.pdo_map import valid_pdos

USUAL_TOLERANCE = 0.01  # revolutions, as in docs/second-position.md
LEAST_MOTION_CYCLES = 0.01  # where nothing is stated
SECOND = od.SAMPLE_SECOND_POSITION.mapped(32)


def window_of(plan: Plan, budget: ResidualBudget) -> SampleWindow:
    """What the samples of a module are held against; a second position of 0.01 revolution if it has none."""
    module = budget.module
    low, high = module.amplitude_limits_counts
    tolerance = second_tolerance(budget) or USUAL_TOLERANCE
    return SampleWindow(
        full_scale_counts=module.full_scale_counts,
        low_counts=low,
        high_counts=high,
        nominal_counts=plan.situation.errors.amplitude * module.full_scale_counts,
        limit_cycles=budget.limit_cycles,
        order=THIRD if module.is_third_order else 2,
        motion_cycles=min(budget.motion_part.cycles or LEAST_MOTION_CYCLES, budget.limit_cycles),
        tolerance_cycles=tolerance * module.cycles_per_revolution,
    )


def second_tolerance(budget: ResidualBudget) -> float | None:
    """2014:04, revolutions, of a module that gets a second position; else None."""
    values = budget.module.values
    mapped = (pdo.entries for pdo in valid_pdos(values.get, od.RPDO, od.RPDO_MAPPING))
    tolerance = float(values.get(od.SECOND_TOLERANCE, 0.0))
    return tolerance if tolerance and any(SECOND in one for one in mapped) else None


def area_line(plan: Plan, budget: ResidualBudget) -> str:
    """The figure that is published of the vector length, in a line."""
    found = area_coverage_of(window_of(plan, budget))
    return (
        f"    coverage of any voltages (1 - allowed area / whole area): {_percent(found.amplitude)} by the "
        f"amplitude, {_percent(found.residual)} with the residual"
    )


def coverage_lines(plan: Plan, budget: ResidualBudget) -> list[str]:
    """The faults one by one, as a table."""
    window = window_of(plan, budget)
    tolerance, mapped = second_tolerance(budget), "2014:04"
    if tolerance is None:
        tolerance, mapped = USUAL_TOLERANCE, "none is mapped"
    rows = [
        f"  diagnostic coverage in motion, {CASES} faults each of {FAULTY_SAMPLES} samples, no certificate",
        f"    (docs/faults.md); second position within {tolerance:g} revolution ({mapped})",
        f"    {'fault':<26}{'amplitude':>10}{'+ residual':>12}{'+ second':>10}{'99 % within':>20}",
    ]
    for one in fault_coverage_of(window):
        cells = (_percent(share) for share in (one.shares.amplitude, one.shares.residual, one.shares.second))
        amplitude, residual, second = cells
        rows.append(f"    {one.name:<26}{amplitude:>10}{residual:>12}{second:>10}{_time(one, budget):>20}")
    return rows


def coverage_figures(plan: Plan, budget: ResidualBudget) -> dict[str, Any]:
    """The same for programs; parts 0..1, seconds."""
    window = window_of(plan, budget)
    return {
        "any_voltages": _figures(area_coverage_of(window)),
        "second_position_cycles": window.tolerance_cycles,
        "second_position_mapped": second_tolerance(budget) is not None,
        "faults": {
            one.name: {
                **_figures(one.shares),
                "harmful": one.harmful / CASES,
                "within_s": None if one.within is None else one.within * budget.interval_s,
            }
            for one in fault_coverage_of(window)
        },
    }


def _figures(shares: Shares) -> dict[str, float | None]:
    return {"amplitude": shares.amplitude, "residual": shares.residual, "second_position": shares.second}


def _time(one: FaultCoverage, budget: ResidualBudget) -> str:
    if one.within is None:
        return "-"
    samples = "sample" if one.within == 1 else "samples"
    return f"{one.within} {samples}, {one.within * budget.interval_s * 1e3:.3g} ms"


def _percent(part: float | None) -> str:
    """Rounded down: what is not whole is not shown as whole."""
    return "-" if part is None else f"{int(1000.0 * part + 1e-9) / 10.0:.1f} %"
