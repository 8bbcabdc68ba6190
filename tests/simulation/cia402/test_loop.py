"""The position loop of the drive, and the trajectory that it follows."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.simulation.cia402.axis import nearest, saturated, wrapped
from canfb.simulation.cia402.loop import Demand, Gains, PositionLoop, Trajectory, approach, chosen_gains

GAINS = Gains(50.0, 0.2, 0.04, 1.0, 1.0, 1e-3)


def step(loop: PositionLoop, demand: Demand, position: float = 0.0, speed: float = 0.0) -> float:
    return loop.step(
        demand, position, speed, GAINS, period_s=1e-3, torque_limit_nm=0.5, speed_limit_rad_s=300.0
    )


def test_gains_that_are_0_are_chosen_and_others_are_kept() -> None:
    chosen = chosen_gains(Gains(0.0, 0.0, 0.0, 1.0, 0.5, 1e-3), 1e-3)
    assert (chosen.position, chosen.velocity, chosen.integral_s) == pytest.approx((50.0, 0.2, 0.04))
    assert chosen_gains(GAINS, 5e-3) == GAINS


def test_the_torque_is_the_sum_of_its_parts() -> None:
    demand = Demand(1e-5, 0.1, 10.0)
    loop = PositionLoop()
    assert step(loop, demand, 0.0, 0.1) == pytest.approx(0.2 * 50 * 6.283185e-5 + 1e-3 * 10.0, rel=1e-6)
    assert not loop.limited


def test_a_deviation_that_stays_is_integrated_up_to_the_limit() -> None:
    loop = PositionLoop()
    torques = [step(loop, Demand(0.0, 0.5), 0.0, 0.0) for _ in range(500)]
    assert torques[:3] == pytest.approx([0.1, 0.1025, 0.105])
    assert torques[-1] == 0.5
    assert loop.limited
    assert step(loop, Demand(0.0), 0.0, 0.5) < 0.5, "it leaves the limit at once"
    loop.reset()
    assert step(loop, Demand(0.0), 0.0, 0.0) == 0.0


@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(-1e4, 1e4), st.floats(-1e3, 1e3))
def test_the_torque_is_within_its_limit(demand: float, speed: float, change: float, position: float) -> None:
    loop = PositionLoop()
    for _ in range(3):
        assert abs(step(loop, Demand(demand, speed, change), position, speed / 2)) <= 0.5


@given(st.floats(-1e4, 1e4))
def test_the_approach_is_no_faster_than_the_motor_brakes(error: float) -> None:
    speed = approach(error, 50.0, 350.0)
    assert speed * error >= 0.0
    assert abs(speed) <= 50.0 * abs(error)
    assert speed * speed / (2 * 350.0) <= abs(error) + 1e-9
    near = approach(error * (1 + 1e-9), 50.0, 350.0)
    assert near == pytest.approx(speed, rel=1e-6, abs=1e-12)


@given(st.integers(-(10**12), 10**12))
def test_what_wraps_is_an_integer32_of_the_same_count(value: int) -> None:
    shown = wrapped(value)
    assert -(1 << 31) <= shown < 1 << 31
    assert (shown - value) % (1 << 32) == 0


@given(st.integers(-(1 << 31), (1 << 31) - 1), st.integers(-(10**12), 10**12))
def test_the_nearest_of_all_positions_that_show_alike(target: int, reference: int) -> None:
    place = nearest(target, reference)
    assert wrapped(place) == target
    assert abs(place - reference) <= 1 << 31


@pytest.mark.parametrize(
    ("value", "shown"),
    [(1.4, 1), (-1.6, -2), (40000.0, 32767), (-1e99, -32768), (float("inf"), 32767), (float("nan"), 0)],
)
def test_what_does_not_fit_is_saturated(value: float, shown: int) -> None:
    assert saturated(value, 16) == shown


T = 1e-3


@pytest.mark.parametrize("speed", [-100.0, 100.0, 0.05])
def test_a_ramp_takes_the_way_of_its_deceleration(speed: float) -> None:
    trajectory = Trajectory()
    trajectory.place(0.0, speed)
    count = 1
    while not trajectory.brake(1000.0, T):
        count += 1
    assert trajectory.position == pytest.approx(math.copysign(speed * speed / 2000.0, speed), rel=1e-6)
    assert count == pytest.approx(abs(speed) / 1000.0 / T, abs=1)


def test_targets_are_joined_by_straight_lines() -> None:
    trajectory = Trajectory()
    seen = []
    for count in range(12):
        if count in (1, 5):
            trajectory.set_target(8.0 * count, 4)
        trajectory.advance(T)
        seen.append((trajectory.position, trajectory.speed * T))
    assert [position for position, _ in seen] == [0, 2, 4, 6, 8, 16, 24, 32, 40, 40, 40, 40]
    assert [speed for _, speed in seen] == [0, 2, 2, 2, 2, 8, 8, 8, 8, 0, 0, 0]
