"""The limits of motion and analog path: eq. 10, eq. 12, those that others print, and what to change first."""

import math
import re
from typing import Any

import pytest
from hypothesis import given, strategies as st
from planning_kit import planned

import canfb
from canfb import Conditioning, FeedbackModule, ModuleConfig
from canfb.module.parameters import configured_defaults
from canfb.planning.hints import changes_of
from canfb.planning.plan import PEAK, RAW_PHASE_ERROR_CYCLES, Limited, Plan, ResidualBudget
from canfb.planning.plan_rows import analog_row
from canfb.planning.planned_bus import PlannedModule
from canfb.signal.limits import narrowed_residual_limit, samples_without_harm
from canfb.simulation.scenario import MotionConfig
from canfb.simulation.set_up import of_motion
from documentation import page
from drawing import examples
from folding import each

RPM = 60.0 / (2.0 * math.pi)
LIMIT = 21845 / 65536


def budget(**stated: object) -> ResidualBudget:
    return planned(**stated).budgets[0]


def known(plan: Plan, value: float, subindex: int = 2) -> ResidualBudget:
    module = plan.modules[0].with_values({(0x2010, subindex): value})
    return ResidualBudget(plan, module)


def test_the_figures_are_those_that_run_and_simulate_print() -> None:
    module = FeedbackModule(ModuleConfig(node_id=0x20))
    for us, rpm in ((10.0, "200"), (100.0, "20")):
        assert f"{rpm} rpm at ±{us:g} µs" in module.speed_limit()
        for one in budget(jitter_us=us), known(planned(), us * 1e-6, 0x0D):
            assert f"{one.equation_speed_rad_s * RPM:.3g}" == rpm
    demand = of_motion(MotionConfig(rpm=600.0, ramp_s=0.2), ModuleConfig(node_id=1), 1000.0)
    found = budget(rpm=600.0, acceleration_rad_s2=demand.acceleration_rad_s2)
    assert found.equation_rad_s2 == pytest.approx(demand.allowed_rad_s2, rel=1e-4)
    assert found.largest_acceleration_rad_s2 == pytest.approx(demand.left_rad_s2, rel=1e-4)
    assert found.least_sync_hz == pytest.approx(demand.least_rate_hz, rel=1e-4)


def test_the_error_of_table_1() -> None:
    import numpy as np

    phase = np.arange(100_000) / 100_000
    raw = canfb.phase_in_cycle(np.sin(2 * np.pi * phase), np.cos(2 * np.pi * phase))
    largest = np.abs((raw - phase + 0.5) % 1.0 - 0.5).max()
    assert 0.99 * RAW_PHASE_ERROR_CYCLES < largest <= RAW_PHASE_ERROR_CYCLES * 1.002


@given(st.floats(0.01, 0.5), st.floats(1.0, 5000.0), st.floats(0.0, 40.0), st.floats(1.0, 2000.0))
def test_the_largest_speed_and_acceleration_use_up_the_limit(
    limit: float, acceleration: float, jitter_us: float, rpm: float
) -> None:
    one = budget(
        residual_limit=limit, acceleration_rad_s2=acceleration, jitter_us=jitter_us, rpm=rpm, table=True
    )
    for most, words in (
        (one.largest_acceleration_rad_s2, {"rpm": rpm}),
        (one.largest_speed_rad_s, {"acceleration_rad_s2": acceleration}),
    ):
        if not 0.0 < most < 1e5:  # a wheel that turns at 1e6 rpm is refused
            continue
        name = "acceleration_rad_s2" if "rpm" in words else "rpm"
        scale = 1.0 if "rpm" in words else RPM
        found = planned(
            residual_limit=limit, jitter_us=jitter_us, table=True, **words, **{name: most * scale}
        ).budgets[0]
        alone_too_much = found.needed_cycles > 1.001 * found.limit_cycles
        assert alone_too_much or found.needed_cycles == pytest.approx(found.limit_cycles, rel=1e-6)


@given(st.integers(10, 50_000), st.floats(10.0, 4000.0), st.floats(0.1, 50.0), st.booleans(), st.booleans())
def test_the_limits_fall_and_rise_as_they_must(
    cycles: int, rate_hz: float, jitter_us: float, times: bool, table: bool
) -> None:
    words = {"cycles_per_revolution": cycles, "rate_hz": rate_hz, "jitter_us": jitter_us, "times": times}
    words |= {"table": table, "bit_rate": 1_000_000, "acceleration_rad_s2": 0.001, "rpm": 0.1}

    def limits(**other: object) -> tuple[float, float]:
        one = budget(**{**words, **other})
        return one.largest_speed_rad_s, one.largest_acceleration_rad_s2

    slack = 1.0 + 1e-9
    speed, acceleration = limits()
    for other in (
        {"cycles_per_revolution": 2 * cycles},
        {"jitter_us": 2.0 * jitter_us},
        {"residual_limit": 0.2},
        {"noise_counts": 20.0},
        {"extra_load": 0.05},
    ):
        worse = limits(**other)
        assert worse[0] <= speed * slack, other
        assert worse[1] <= acceleration * slack, other
    assert limits(rate_hz=rate_hz * 1.1)[1] >= acceleration or rate_hz > 900.0
    assert limits(table=True)[1] >= acceleration
    assert limits(times=True)[0] >= speed or jitter_us < 0.2


def test_the_known_acceleration_narrows_as_in_the_module_and_its_margin_is_1() -> None:
    one = known(planned(), 25.0)
    assert one.limit_cycles == narrowed_residual_limit(
        LIMIT, 25.0, 2500, 1e-3, phase_error_cycles=819 / 65536
    )
    assert one.asked_rad_s2 == 25.0
    assert one.margins[Limited.RESIDUAL] == 1.0
    assert known(planned(acceleration_rad_s2=5.0), 25.0).asked_rad_s2 == 5.0
    assert known(planned(acceleration_rad_s2=26.0), 25.0).margins[Limited.RESIDUAL] < 1.0


def test_an_uncorrected_phase_takes_what_the_module_allows_it_and_noise_is_within() -> None:
    one = budget(acceleration_rad_s2=0.0)
    assert one.needed_cycles == 4 * 819 / 65536
    assert budget(noise_counts=5.0).needed_cycles > 4 * 819 / 65536
    assert budget(table=True).needed_cycles < 0.006
    assert budget(phase_error_cycles=0.02).needed_cycles == pytest.approx(
        0.08 + PEAK * math.sqrt(6.0) * one.phase_noise_cycles
    )
    few_bits = planned(adc_bits=6).budgets[0]
    assert PEAK * math.sqrt(6.0) * few_bits.phase_noise_cycles == pytest.approx(
        64.0 * PEAK * math.sqrt(6.0) * one.phase_noise_cycles
    )


def test_what_is_not_stated_has_no_margin() -> None:
    assert {margin.limited for margin in planned().margins} == {Limited.BUS, Limited.RESIDUAL}
    stated = planned(rpm=0.0, acceleration_rad_s2=0.0, jitter_us=5.0)
    assert stated.holds
    assert math.isinf(next(one.factor for one in stated.margins if one.limited is Limited.SPEED))


def test_the_samples_in_a_row_are_those_of_the_page() -> None:
    rows = dict(re.findall(r"^\| (\d) \| 1/(\d) \|", page("supervision"), re.M))
    safe = {n: min(1.0 / (n + 2), 1.0 / ((n + 2) ** 2 // 4)) for n in range(1, 41)}
    assert {int(n): 1.0 / int(part) for n, part in rows.items()} == {n: safe[n] for n in (1, 2, 3)}
    for n in range(1, 41):
        largest, changes = safe[n], n + 2
        assert largest * max(changes, changes**2 // 4) == pytest.approx(1.0)
        assert samples_without_harm(largest) == n
        assert samples_without_harm(largest * (1.0 + 1e-6)) == n - 1
    assert samples_without_harm(0.0) == 255


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_wider_limit_never_detects_more(one: float, two: float) -> None:
    n, m = samples_without_harm(min(one, two)), samples_without_harm(max(one, two))
    assert n >= m
    assert n == 0 or max(n + 2, (n + 2) ** 2 // 4) * min(one, two) <= 1.0 + 1e-6


SPEED = 3000.0 / 60.0 * 2.0 * math.pi


def lines(speed: float | None = SPEED, **fields: Any) -> list[str]:
    values = configured_defaults(ModuleConfig(node_id=32, **fields))
    return list(analog_row(PlannedModule(node_id=32, values=values), speed).words)


def test_the_path_of_the_issue() -> None:
    used = Conditioning(cosine_delay_s=1e-6, delay_s=1.0 / (2.0 * math.pi * 125e3))
    (line,) = lines(conditioning=used, corner_hz=125e3)
    assert line.strip() == (
        "analog path at 125 kHz: +0.125 cycle between the tracks, removed; 71 % of the amplitude left; "
        "+0.125 cycle of delay, added to the position"
    )


def test_a_module_that_knows_none_has_no_line() -> None:
    assert lines() == []
    assert lines(None, corner_hz=1e5) == []


@pytest.mark.parametrize(("delay_us", "exceeded"), [(1.8, False), (2.0, True), (-2.0, True)])
def test_tracks_that_become_one_are_exceeded(delay_us: float, exceeded: bool) -> None:
    (line,) = lines(conditioning=Conditioning(cosine_delay_s=delay_us * 1e-6))
    assert line.endswith("<- exceeded") == exceeded


def texts(plan: Plan) -> list[str]:
    return [f"{one.for_what}: {one.text}" for one in changes_of(plan)]


FIRST: dict[str, dict[str, Any]] = {
    "speed: send sample times with the ADC PDO (times: true)": {"rpm": 3000.0, "jitter_us": 10.0},
    "speed: turn at 34450 rpm at most": {"rpm": 1e5, "times": True},
    "acceleration: measure the correction table (canfb calibrate)": {"acceleration_rad_s2": 750.0},
    "acceleration: raise residual_limit (2010:01) to 0.090 cycle":
        {"acceleration_rad_s2": 100.0, "residual_limit": 0.06},
    "acceleration: raise the SYNC rate to 1500 Hz": {"acceleration_rad_s2": 1600.0},
    "acceleration: send three samples for each SYNC (samples_per_sync: 3; "
    "8 bytes more for each SYNC, bus load +13.5 %): sufficient for this motion":
        {"acceleration_rad_s2": 6000.0},
    "acceleration: raise the SYNC rate to 1100 Hz":
        {"acceleration_rad_s2": 900.0, "bit_rate": 500_000, "table": True},
    "acceleration: raise the SYNC rate to 1500 Hz, and the bit rate to 800000 bit/s":
        {"acceleration_rad_s2": 1600.0, "bit_rate": 500_000},
    "acceleration: accelerate by 711.8 rad/s^2 at most": {"acceleration_rad_s2": 60000.0},
    "bus load: raise the bit rate to 250000 bit/s": {"rate_hz": 500.0, "bit_rate": 125_000},
    "bus load: lower the SYNC rate to 2200 Hz": {"rate_hz": 3000.0},
    "bus load: 2 of the 3 modules fit on this bus: give the others a second one":
        {"modules": 3, "acceleration_rad_s2": 700.0},
    "bus load: other nodes leave no room: move them to another bus": {"extra_load": 1.0},
    "residual: average the tracks, or raise their amplitude: their noise alone exceeds the limit":
        {"noise_counts": 500.0},
    "detection: set max_acceleration_rad_s2 (2010:02) to 25: the residual limit becomes 0.060":
        {"acceleration_rad_s2": 25.0},
    "detection: lower residual_limit (2010:01) to 0.101 cycle":
        {"acceleration_rad_s2": 100.0, "rpm": 1000.0, "times": True, "jitter_us": 50.0},  # above 2010:02
}  # fmt: skip


@each("first", FIRST)
def test_the_first_change(first: str) -> None:
    assert texts(planned(**FIRST[first]))[0] == first


def test_a_plan_that_cannot_be_sharper_has_nothing_to_change() -> None:
    plan = planned(acceleration_rad_s2=25.0, residual_limit=0.061)
    assert (plan.holds, texts(plan)) == (True, [])
    assert texts(planned()) == [], "nothing is stated"


def test_after_the_limit_is_narrowed_the_rate_makes_it_sharp() -> None:
    first, then = changes_of(planned(acceleration_rad_s2=200.0))
    assert (first.for_what, then.for_what) == ("detection", "detection")
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
            assert [plan.holds, after.holds] == [True, True]
        else:
            assert step.for_what == plan.tightest.limited.value
            assert all(one.holds for one in after.margins if one.limited.value == step.for_what)
        plan = after
