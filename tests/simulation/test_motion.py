"""Motions: the position is the integral of the speed."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.simulation.motion import Motion, Ramp, Ripple

speeds = st.floats(-3000, 3000)
durations = st.one_of(st.just(0.0), st.floats(1e-6, 5))  # numpy's interpolation fails on subnormal ones
ramps = st.lists(st.builds(Ramp, durations, speeds), max_size=4).map(tuple)
ripples = st.lists(st.builds(Ripple, st.floats(-100, 100), st.floats(0.1, 5)), max_size=2).map(tuple)


def speed_rpm(motion: Motion, time_s: np.ndarray) -> np.ndarray:
    """The speed as the class describes it: straight lines through the ends of the ramps, and the ripple."""
    times, values = [0.0], [motion.start_rpm]
    for ramp in motion.ramps:
        times.append(times[-1] + ramp.duration_s)
        values.append(ramp.end_rpm)
    speed = np.interp(time_s, times, values)
    for ripple in motion.ripples:
        speed = speed + ripple.size_rpm * np.sin(2 * np.pi * ripple.frequency_hz * time_s)
    return speed


def integrated(motion: Motion, until_s: float) -> float:
    """Revolutions by the trapezoidal rule, with nodes at the ends of the ramps."""
    ends = np.cumsum([0.0, *(ramp.duration_s for ramp in motion.ramps)])
    corners = np.unique([0.0, until_s, *(end for end in ends if end < until_s)])
    total = 0.0
    for start, stop in itertools.pairwise(corners):
        # Inside of the interval only: at a corner itself a ramp of no duration jumps.
        middle = (np.arange(4000) + 0.5) / 4000 * (stop - start) + start
        total += float(np.mean(speed_rpm(motion, middle))) * (stop - start) / 60
    return total


@given(ramps, ripples, speeds, st.floats(0, 20))
def test_the_position_is_the_integral_of_the_speed(
    ramps: tuple[Ramp, ...], ripples: tuple[Ripple, ...], start_rpm: float, time_s: float
) -> None:
    motion = Motion(ramps, ripples, start_rpm)
    assert motion.revolutions(time_s) == pytest.approx(integrated(motion, time_s), rel=1e-6, abs=1e-3)
    times = np.linspace(0.0, time_s, 7)
    assert motion.revolutions_at(times) == pytest.approx([motion.revolutions(t) for t in times], abs=1e-9)


@given(ramps, ripples, speeds)
def test_it_starts_at_zero(ramps: tuple[Ramp, ...], ripples: tuple[Ripple, ...], start_rpm: float) -> None:
    assert Motion(ramps, ripples, start_rpm).revolutions(0.0) == 0.0


def test_written_out_by_hand() -> None:
    motion = Motion((Ramp(1.0, 0.0), Ramp(2.0, 60.0), Ramp(0.0, -60.0)))
    assert [motion.revolutions(t) for t in (0.0, 1.0, 2.0, 3.0, 4.0)] == [0.0, 0.0, 0.25, 1.0, 0.0]


def test_a_ripple_swings_about_its_mean_and_comes_back() -> None:
    motion = Motion((), (Ripple(60.0, 2.0),))
    assert motion.revolutions(0.25) == pytest.approx(2.0 / (2 * math.pi * 2.0))
    assert motion.revolutions(0.5) == pytest.approx(0.0, abs=1e-12)
    later = [motion.revolutions(n / 1000) for n in range(2000)]
    assert min(later) >= 0.0
    assert max(later) == pytest.approx(1 / (2 * math.pi), rel=1e-6)
