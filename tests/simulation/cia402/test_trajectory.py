from __future__ import annotations

import math

import pytest

from canfb.simulation.cia402.loop import Trajectory

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
