"""The clock of a CAN controller on the time of day: drift, delays, clocks that are set."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.bus.clocks import LONGEST_LATENCY_S, WINDOW_S, HardwareTimes

WALL_S, HARDWARE_S = 1.8e9, 77.0
LEAST_DELAY_S = 20e-6


@given(
    st.floats(-100e-6, 100e-6),
    st.lists(st.floats(0.0, 2e-3), min_size=300, max_size=400),
)
def test_jitter_of_the_delay_is_taken_off(drift: float, delays_s: list[float]) -> None:
    """One frame of five is on time: the rest follow its delay, and the drift of two windows."""
    times = HardwareTimes()
    for number, delay_s in enumerate(delays_s):
        true_s = number * 1e-3
        late_s = LEAST_DELAY_S + (delay_s if number % 5 else 0.0)
        got = times.received(HARDWARE_S + true_s * (1.0 + drift), WALL_S + true_s + late_s)
        assert got <= WALL_S + true_s + late_s + 1e-6
        assert got - WALL_S - true_s == pytest.approx(LEAST_DELAY_S, abs=2 * WINDOW_S * abs(drift) + 1e-6)


@pytest.mark.parametrize("step_s", [-3600.0, -0.02, 0.02, 1.0, 3600.0])
@pytest.mark.parametrize("which", ["wall", "controller"])
def test_a_clock_that_is_set_is_followed_at_once(step_s: float, which: str) -> None:
    times = HardwareTimes()
    for number in range(400):
        true_s = number * 1e-3
        wall_s = WALL_S + true_s + (step_s if number >= 200 and which == "wall" else 0.0)
        hardware_s = HARDWARE_S + true_s + (step_s if number >= 200 and which == "controller" else 0.0)
        got = times.received(hardware_s, wall_s + LEAST_DELAY_S)
        assert wall_s - LONGEST_LATENCY_S <= got <= wall_s + LEAST_DELAY_S + 1e-6
    assert got == pytest.approx(wall_s + LEAST_DELAY_S, abs=1e-6)


def test_a_single_frame_has_the_time_of_the_kernel() -> None:
    assert HardwareTimes().received(HARDWARE_S, WALL_S) == WALL_S
