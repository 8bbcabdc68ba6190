"""The clock of the encoder interface: it drifts, it wraps, and it never goes back."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.interface.sample_instants import SampleClock
from folding import each

WRAP = 1 << 32
drifts = st.floats(-10_000, 10_000)
starts = st.integers(-(1 << 40), 1 << 40)
times = st.floats(0, 1e7)  # of a monotonic clock: four months
steps = st.floats(0, 420)  # less than a turn of the clock


@given(drifts, starts, times, steps)
def test_ticks_pass_as_time_does_whatever_it_shows(
    drift_ppm: float, start: int, now: float, step_s: float
) -> None:
    clock = SampleClock(drift_ppm, start)
    first, second = clock.ticks(now), clock.ticks(now + step_s)
    assert 0 <= first < WRAP
    passed = (second - first) % WRAP
    # A tick at either end, and what a float of such a time cannot hold.
    assert passed == pytest.approx(step_s * 1e7 * (1 + drift_ppm * 1e-6), abs=1.1 + 4 * math.ulp(now) * 1e7)


@given(starts)
def test_it_wraps_after_429_seconds(start: int) -> None:
    clock = SampleClock(0.0, start)
    turn_s = WRAP * 1e-7
    assert clock.ticks(0.0) == start % WRAP
    assert clock.ticks(turn_s + 1e-9) == start % WRAP
    assert clock.ticks(turn_s - 5e-8) == (start - 1) % WRAP


@each("drift_ppm", [10_001, -10_001, math.nan, math.inf])
def test_a_drift_that_no_clock_has_is_refused(drift_ppm: float) -> None:
    with pytest.raises(ValueError, match="drift_ppm must be a number"):
        SampleClock(drift_ppm)
