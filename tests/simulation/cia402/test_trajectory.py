from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canfb.simulation.cia402.loop import Interpolation, Trajectory

T = 1e-3


def run_profile(
    trajectory: Trajectory, target: float, velocity: float, acceleration: float, deceleration: float
) -> list[float]:
    positions = [trajectory.position]
    for _ in range(20_000):
        if trajectory.profile(target, velocity, acceleration, deceleration, T):
            break
        positions.append(trajectory.position)
    else:
        raise AssertionError("it never arrives")
    assert trajectory.position == target
    assert trajectory.speed == 0.0
    return [*positions, trajectory.position]


def test_a_long_move_is_a_trapezoid() -> None:
    positions = run_profile(Trajectory(), 1000.0, 500.0, 1000.0, 2000.0)
    ideal = 0.5 + 0.25 + (1000.0 - 62.5 - 125.0) / 500.0
    assert len(positions) * T == pytest.approx(ideal, abs=0.01)
    speeds = [(after - before) / T for before, after in itertools.pairwise(positions)]
    assert max(speeds) == pytest.approx(500.0)
    assert sum(speed > 499.0 for speed in speeds) * T == pytest.approx(812.5 / 500.0, abs=0.01)


@settings(deadline=None, max_examples=60)
@given(
    st.floats(-200, 200),
    st.floats(-100, 100),
    st.floats(50, 500),
    st.floats(200, 5000),
    st.floats(200, 5000),
)
def test_any_move_arrives_within_its_limits(
    target: float, speed: float, velocity: float, acceleration: float, deceleration: float
) -> None:
    trajectory = Trajectory()
    trajectory.place(0.0, speed)
    positions = run_profile(trajectory, target, velocity, acceleration, deceleration)
    speeds = [speed] + [(b - a) / T for a, b in itertools.pairwise(positions)]
    largest = max(acceleration, deceleration) * T
    # The last step ends what is left: no more than twice the deceleration of a period.
    assert all(abs(b - a) <= 2.0 * largest + 1e-9 for a, b in itertools.pairwise(speeds))
    assert max(map(abs, speeds)) <= max(velocity, abs(speed)) + largest
    if speed == 0.0:  # from rest it never goes beyond
        assert min(0.0, target) - 1e-9 <= min(positions) <= max(positions) <= max(0.0, target) + 1e-9


def test_a_target_behind_turns_the_motion_round() -> None:
    trajectory = Trajectory()
    trajectory.place(100.0, 50.0)
    positions = run_profile(trajectory, 90.0, 100.0, 1000.0, 1000.0)
    assert max(positions) == pytest.approx(101.25, abs=0.1)


def test_where_it_is_already_it_stays() -> None:
    trajectory = Trajectory()
    trajectory.place(5.0)
    assert trajectory.profile(5.0, 1.0, 1.0, 1.0, T)


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
    trajectory, interpolation = Trajectory(), Interpolation()
    seen = []
    for count in range(12):
        if count in (1, 5):
            interpolation.set_target(8.0 * count, 4)
        interpolation.advance(trajectory, T)
        seen.append((trajectory.position, trajectory.speed * T))
    assert [position for position, _ in seen] == [0, 2, 4, 6, 8, 16, 24, 32, 40, 40, 40, 40]
    assert [speed for _, speed in seen] == [0, 2, 2, 2, 2, 8, 8, 8, 8, 0, 0, 0]
