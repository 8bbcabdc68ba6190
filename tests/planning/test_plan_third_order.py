"""A plan with third-order prediction at its own limits, in simulated time: 0.95 holds, 1.05 is flagged."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from planning_kit import RATE_HZ, cycles, jerked, planned, play, up_to_speed

import canfb
from canfb.planning.jerk_budget import JerkBudget
from canfb.planning.plan import JerkDetection, Limited, Plan
from canfb.planning.plan_changes import changes_of
from canfb.signal.declared import Declared
from canfb.signal.limits import limit_narrowed_by_jerk

HELD, FLAGGED = 0.95, 1.05
RPM = 2.0 * math.pi / 60.0
ORDER_3: dict[str, Any] = {"prediction_order": 3}
LIMIT = 21845 / 65536
SERVO: dict[str, Any] = {"acceleration_rad_s2": 7850.0, "jerk_rad_s3": 785_000.0, "table": True}


def texts(plan: Plan) -> list[str]:
    return [f"{one.for_what}: {one.text}" for one in changes_of(plan)]


@pytest.mark.parametrize("part", [HELD, FLAGGED])
def test_jerk(part: float) -> None:
    limit = planned(**ORDER_3, table=True, jerk_rad_s3=1.0).budgets[0].largest_jerk_rad_s3
    stated = part * limit
    assert planned(**ORDER_3, table=True, jerk_rad_s3=stated).holds is (part == HELD)
    found = play(jerked(cycles(stated), 0.01), 0.3, table=True, **ORDER_3)
    assert found.holds is (part == HELD), max(found.residuals)


def test_jerk_without_a_table() -> None:
    limit = planned(**ORDER_3, jerk_rad_s3=1.0).budgets[0].largest_jerk_rad_s3
    found = play(jerked(cycles(HELD * limit), 0.01), 0.3, **ORDER_3)
    assert found.holds, max(found.residuals)
    assert not play(jerked(cycles(1.5 * limit), 0.01), 0.3, **ORDER_3).holds


@pytest.mark.parametrize("part", [HELD, FLAGGED])
def test_a_step_of_the_acceleration_in_the_middle_of_an_interval(part: float) -> None:
    words = {**ORDER_3, "table": True}
    limit = planned(acceleration_rad_s2=1.0, **words).budgets[0].largest_acceleration_rad_s2
    stated = part * limit
    assert planned(acceleration_rad_s2=stated, **words).holds is (part == HELD)
    motion = up_to_speed(cycles(stated * 0.2), cycles(stated), start_s=0.1 + 0.5 / RATE_HZ)
    found = play(motion, 0.3, table=True, **ORDER_3)
    assert found.holds is (part == HELD), max(found.residuals)


@pytest.mark.parametrize("part", [HELD, FLAGGED])
def test_jerk_with_sample_times_and_a_jitter_that_stretches_the_intervals(part: float) -> None:
    words = {**ORDER_3, "times": True, "table": True, "jitter_us": 80.0, "rpm": 300.0}
    words["phase_error_cycles"] = 0.0  # few of the errors meet the longest intervals
    limit = planned(jerk_rad_s3=1.0, **words).budgets[0].largest_jerk_rad_s3
    stated = part * limit
    assert planned(jerk_rad_s3=stated, **words).holds is (part == HELD)
    off = (-80e-6, -80e-6, -80e-6, 80e-6)
    motion = jerked(cycles(stated), math.sqrt(300.0 * RPM / stated))
    found = play(motion, 0.3, table=True, times=True, off_s=lambda k: off[k % 4], **ORDER_3)
    assert found.holds is (part == HELD), max(found.residuals)


@pytest.mark.parametrize("part", [HELD, FLAGGED])
def test_speed_under_jitter(part: float) -> None:
    words = {**ORDER_3, "table": True, "jitter_us": 20.0, "jerk_rad_s3": 3000.0}
    limit = planned(rpm=1.0, **words).budgets[0].largest_speed_rad_s
    stated = part * limit
    assert planned(rpm=stated / RPM, **words).holds is (part == HELD)
    found = play(
        jerked(cycles(3000.0), math.sqrt(stated / 3000.0)),
        0.4,
        table=True,
        off_s=lambda k: 20e-6 if k % 2 else -20e-6,
        **ORDER_3,
    )
    assert found.holds is (part == HELD), max(found.residuals)


@pytest.mark.parametrize("part", [HELD, FLAGGED])
def test_the_known_acceleration(part: float) -> None:
    """2010:02 of the module; the acceleration comes smoothly, and lasts."""
    jerk, known = 5000.0, 1000.0
    plan = planned(**ORDER_3, table=True, jerk_rad_s3=jerk, acceleration_rad_s2=known)
    module = plan.plan_input.modules[0].with_values({(0x2010, 2): known})
    limit = JerkBudget(plan.plan_input, module).largest_acceleration_rad_s2
    assert limit > known
    motion = jerked(cycles(jerk), part * limit / jerk)
    found = play(motion, 0.6, table=True, max_acceleration_rad_s2=known, **ORDER_3)
    assert found.holds is (part == HELD)


@pytest.mark.parametrize("part", [HELD, FLAGGED])
def test_residual_limit(part: float) -> None:
    words = {**ORDER_3, "table": True, "jerk_rad_s3": 400_000.0}
    needed = planned(**words).budgets[0].needed_cycles
    assert planned(residual_limit=needed / part, **words).holds is (part == HELD)
    found = play(jerked(cycles(400_000.0), 0.01), 0.3, table=True, residual_limit=needed / part, **ORDER_3)
    assert found.holds or part == FLAGGED
    assert 0.9 * needed <= max(found.residuals) <= needed


def test_without_errors_it_is_the_public_formula() -> None:
    one = planned(**ORDER_3, jitter_us=10.0).budgets[0]
    assert one.equation_rad_s3 == canfb.max_jerk(2500, RATE_HZ, LIMIT)
    assert one.equation_speed_rad_s == pytest.approx(canfb.max_speed(2500, 10e-6, LIMIT, prediction_order=3))


def test_the_servo_move_of_the_page_holds_and_eq_9_is_told_of_it() -> None:
    assert planned(**ORDER_3, **SERVO).holds
    assert texts(planned(**SERVO)) == [
        "acceleration: set prediction_order: 3 (2010:07): order 3 holds this move"
    ]
    without_a_table = planned(acceleration_rad_s2=7850.0, jerk_rad_s3=700_000.0)
    assert texts(without_a_table)[0] == (
        "acceleration: measure the correction table (canfb calibrate), and "
        "set prediction_order: 3 (2010:07): order 3 holds this move"
    )
    too_much = planned(acceleration_rad_s2=7850.0, jerk_rad_s3=5e6, table=True)
    assert not any("order 3" in text for text in texts(too_much))


@pytest.mark.parametrize(
    ("words", "first"),
    [
        ({"jerk_rad_s3": 800_000.0}, "jerk: measure the correction table (canfb calibrate)"),
        (
            {"jerk_rad_s3": 100_000.0, "residual_limit": 0.1},
            "jerk: raise residual_limit (2010:01) to 0.140 cycle",
        ),
        ({"jerk_rad_s3": 900_000.0, "table": True}, "jerk: raise the SYNC rate to 1100 Hz"),
        ({"jerk_rad_s3": 2e8, "table": True}, "jerk: limit the jerk to 8.136e+05 rad/s^3"),
        ({"acceleration_rad_s2": 900.0}, "acceleration: measure the correction table (canfb calibrate)"),
        (
            {"jerk_rad_s3": 100_000.0},
            "detection: set max_jerk_rad_s3 (2010:08) to 100000: the residual limit becomes 0.140",
        ),
    ],
)
def test_the_first_change(words: dict[str, float], first: str) -> None:
    assert texts(planned(**ORDER_3, **words))[0] == first


def test_what_eq_9_cannot_guard_sharply_third_order_can() -> None:
    first, then = changes_of(planned(acceleration_rad_s2=600.0, jerk_rad_s3=10_000.0))
    assert first.for_what == then.for_what == "detection"
    assert then.text == "set prediction_order: 3 (2010:07), and max_jerk_rad_s3 (2010:08) to 10000"
    after = Plan(then.plan_input)
    assert after.holds
    assert after.detection(after.budgets[0]).is_sharp


def test_the_known_jerk_narrows_as_in_the_module_and_its_margin_is_1() -> None:
    plan = planned(**ORDER_3)
    module = plan.plan_input.modules[0].with_values({(0x2010, 8): 25_000.0})
    one = JerkBudget(plan.plan_input, module)
    assert one.limit_cycles == limit_narrowed_by_jerk(
        LIMIT, 25_000.0, 2500, 1e-3, phase_error_cycles=819 / 65536
    )
    assert one.asked_rad_s3 == 25_000.0
    assert one.margin == 1.0


def test_limits_that_a_plan_has_by_its_order() -> None:
    by_jerk = planned(**ORDER_3, **SERVO)
    assert {margin.limited for margin in by_jerk.margins} == {
        Limited.BUS,
        Limited.ACCELERATION,
        Limited.JERK,
        Limited.RESIDUAL,
    }
    assert math.isinf(by_jerk.budgets[0].largest_acceleration_rad_s2)
    by_acceleration = planned(**SERVO)
    assert Limited.JERK not in {margin.limited for margin in by_acceleration.margins}
    assert math.isinf(by_acceleration.budgets[0].largest_jerk_rad_s3)


def test_detection_is_that_of_the_page_on_third_order() -> None:
    """One missed sample is certain below j = 0.069 with the phase error of an encoder without a table."""
    for jerk, missed in ((0.068, 1), (0.07, 0), (0.0, 2), (0.011, 1)):
        declared = Declared(order=3, residual_limit=jerk + 0.1, jerk=jerk)
        found = JerkDetection(jerk + 0.1, jerk, declared)
        assert found.missed_samples == missed, jerk
        assert found.is_declared
        assert not JerkDetection(jerk + 0.1, jerk + 0.01, declared).is_declared
        assert found.kept_with(phase_error=0.001) >= missed
    assert JerkDetection(0.14, 0.12, Declared(order=3, residual_limit=0.14)).bad_samples == 0
    assert JerkDetection(1 / 6, 1 / 12, Declared(order=3, residual_limit=1 / 6)).bad_samples == 1


@given(st.floats(0.01, 0.5), st.floats(1.0, 1e6), st.floats(0.0, 40.0), st.floats(1.0, 1500.0))
def test_the_largest_speed_and_jerk_use_up_the_limit(
    limit: float, jerk: float, jitter_us: float, rpm: float
) -> None:
    words = {**ORDER_3, "residual_limit": limit, "jitter_us": jitter_us, "table": True}
    one = planned(**words, jerk_rad_s3=jerk, rpm=rpm).budgets[0]
    rpm_at_limit = one.largest_speed_rad_s / RPM
    for other in (
        {"rpm": rpm, "jerk_rad_s3": one.largest_jerk_rad_s3},
        {"jerk_rad_s3": jerk, "rpm": rpm_at_limit},
    ):
        if 0.0 in other.values() or other["rpm"] > 1e6:  # nothing is left, or no speed that can be stated
            continue
        found = planned(**words, **other).budgets[0]
        alone_too_much = found.needed_cycles > 1.001 * found.limit_cycles
        assert alone_too_much or found.needed_cycles == pytest.approx(found.limit_cycles, rel=1e-6)
