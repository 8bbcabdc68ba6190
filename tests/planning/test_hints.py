"""What to change first: each proposal does what it is proposed for."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from planning_kit import planned

from canfb.planning.hints import changes_of
from canfb.planning.plan import Plan
from drawing import examples


def texts(plan: Plan) -> list[str]:
    return [f"{one.for_what}: {one.text}" for one in changes_of(plan)]


@pytest.mark.parametrize(
    ("words", "first"),
    [
        ({"rpm": 3000.0, "jitter_us": 10.0}, "speed: send sample times with the ADC PDO (times: true)"),
        ({"acceleration_rad_s2": 750.0}, "acceleration: measure the correction table (canfb calibrate)"),
        (
            {"acceleration_rad_s2": 100.0, "residual_limit": 0.06},
            "acceleration: raise residual_limit (2010:01) to 0.090 cycle",
        ),
        ({"acceleration_rad_s2": 1600.0}, "acceleration: raise the SYNC rate to 1500 Hz"),
        (
            {"acceleration_rad_s2": 6000.0},
            "acceleration: send three samples for each SYNC (samples_per_sync: 3; "
            "8 bytes more for each SYNC, bus load +13.5 %): that holds this move",
        ),
        (
            {"acceleration_rad_s2": 900.0, "bit_rate": 500_000, "table": True},
            "acceleration: raise the SYNC rate to 1100 Hz",
        ),
        (
            {"acceleration_rad_s2": 1600.0, "bit_rate": 500_000},
            "acceleration: raise the SYNC rate to 1500 Hz, and the bit rate to 800000 bit/s",
        ),
        ({"acceleration_rad_s2": 60000.0}, "acceleration: accelerate by 712.1 rad/s^2 at most"),
        ({"rate_hz": 500.0, "bit_rate": 125_000}, "bus load: raise the bit rate to 250000 bit/s"),
        ({"rate_hz": 3000.0}, "bus load: lower the SYNC rate to 2200 Hz"),
        (
            {"modules": 3, "acceleration_rad_s2": 700.0},
            "bus load: 2 of the 3 modules fit on this bus: give the others a second one",
        ),
        ({"extra_load": 1.0}, "bus load: other nodes leave no room: move them to another bus"),
        (
            {"noise_counts": 500.0},
            "residual: average the tracks, or raise their amplitude: their noise alone exceeds the limit",
        ),
        (
            {"acceleration_rad_s2": 25.0},
            "detection: set max_acceleration_rad_s2 (2010:02) to 25: the residual limit becomes 0.060",
        ),
        (
            {"acceleration_rad_s2": 100.0, "rpm": 1000.0, "times": True, "jitter_us": 50.0},
            "detection: lower residual_limit (2010:01) to 0.101 cycle",  # jitter: more than 2010:02 allows
        ),
    ],
)
def test_the_first_change(words: dict[str, float], first: str) -> None:
    assert texts(planned(**words))[0] == first


def test_a_plan_that_cannot_be_sharper_has_nothing_to_change() -> None:
    plan = planned(acceleration_rad_s2=25.0, residual_limit=0.061)
    assert plan.holds
    assert texts(plan) == []
    assert texts(planned()) == [], "nothing is stated"


def test_after_the_limit_is_narrowed_the_rate_makes_it_sharp() -> None:
    first, then = changes_of(planned(acceleration_rad_s2=200.0))
    assert first.for_what == then.for_what == "detection"
    assert then.text == "raise the SYNC rate to 1200 Hz"
    assert then.plan.budgets[0].detection().is_sharp


STATED = st.fixed_dictionaries(
    {
        "modules": st.integers(1, 3),
        "bit_rate": st.sampled_from([125_000, 250_000, 500_000, 1_000_000]),
        "rate_hz": st.sampled_from([50.0, 200.0, 1000.0, 2500.0]),
        "rpm": st.sampled_from([0.0, 10.0, 300.0, 6000.0]),
        "acceleration_rad_s2": st.sampled_from([0.0, 3.0, 100.0, 2000.0, 1e6]),
        "jitter_us": st.sampled_from([0.0, 5.0, 100.0]),
        "extra_load": st.sampled_from([0.0, 0.2, 0.9]),
        "residual_limit": st.sampled_from([0.02, 0.06, 1.0 / 3.0, 0.5]),
        "noise_counts": st.sampled_from([0.0, 0.5, 30.0]),
        "times": st.booleans(),
    }
)


@examples(20)
@given(STATED)
def test_each_change_is_for_the_tightest_limit_and_makes_it_hold(stated: dict[str, Any]) -> None:
    plan = planned(**stated)
    found = changes_of(plan)
    assert len({step.for_what for step in found} - {"detection"}) == len(
        [step for step in found if step.for_what != "detection"]
    )
    for step in found:
        after = step.plan
        if step.for_what == "detection":
            assert plan.holds
            assert after.holds
        else:
            assert step.for_what == plan.tightest.limited.value
            assert all(one.holds for one in after.margins if one.limited.value == step.for_what)
        plan = after
