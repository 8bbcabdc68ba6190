"""Delay, corners and their uncertainty from fundamentals that are exact but for what repeats badly."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.calibration.path_fit import (
    AMPLITUDE_REPEATS,
    MOST_UNCERTAIN_CYCLES,
    Fundamental,
    PathFit,
    fit_low_pass,
    fit_path,
)
from canfb.errors import CalibrationError
from folding import each

NOISE = 1e-5
SPEEDS_HZ = (2541.0, 12_543.0, 41_711.0, 125_041.0)


def fundamentals(
    speeds_hz: tuple[float, ...],
    delay_s: float,
    corner_hz: float,
    cosine_corner_hz: float,
    seed: int = 0,
    drift: float = 0.0,
) -> list[Fundamental]:
    """By the transfer function, one by one; ``drift`` is the rms change of amplitude between speeds."""
    rng = np.random.default_rng(seed)
    found = []
    for f in speeds_hz:
        s = 1500.0 / complex(1.0, f / corner_hz) if corner_hz else 1500.0 + 0j
        c = 1400.0 / complex(1.0, f / cosine_corner_hz) if cosine_corner_hz else 1400.0 + 0j
        both = 1.0 + drift * rng.normal()
        angle = math.atan2(c.imag, c.real) - math.atan2(s.imag, s.real) + 2.0 * math.pi * f * delay_s - 0.05
        off = 1.0 + NOISE * rng.normal(size=3)
        found.append(
            Fundamental(f, abs(s) * both * off[0], abs(c) * both * off[1], angle + off[2] - 1.0, NOISE)
        )
    return found


@given(
    st.floats(-1.5e-6, 1.5e-6),
    st.floats(5e4, 4e5),
    st.floats(0.9, 1.1),
    st.sampled_from([SPEEDS_HZ, (-125_041.0, 2541.0, 61_000.0), (20_000.0, 125_041.0)]),
    st.integers(0, 1000),
)
def test_delay_and_corners_are_found(
    delay_s: float, corner_hz: float, apart: float, speeds_hz: tuple[float, ...], seed: int
) -> None:
    path = fit_path(fundamentals(speeds_hz, delay_s, corner_hz, corner_hz * apart, seed))
    low_pass = path.low_pass
    assert low_pass.is_detected
    assert low_pass.is_one_pole
    # A difference of the corners that is taken for none shows as delay.
    same = 0.0 if path.corners.cosine_corner_hz else abs(1.0 - 1.0 / apart) / (2.0 * math.pi * corner_hz)
    assert path.cosine_delay_s == pytest.approx(delay_s, abs=4.0 * path.cosine_delay_sigma_s + same)
    assert path.corners.corner_hz == pytest.approx(
        corner_hz, abs=3.0 * low_pass.corner_sigma_hz + 0.6 * abs(1.0 - apart) * corner_hz * bool(same)
    )
    assert max(path.off_cycles) < 2e-4
    top = max(map(abs, speeds_hz))
    true = math.atan(top / corner_hz) / (2.0 * math.pi)
    assert low_pass.delay_cycles(top) == pytest.approx(
        true, abs=1e-3 + 3.0 * low_pass.delay_sigma_cycles(top)
    )


@each("seed", range(20))
def test_the_uncertainty_of_the_delay_covers_amplitudes_that_drift(seed: int) -> None:
    path = fit_path(fundamentals(SPEEDS_HZ, 0.0, 125e3, 125e3, seed, AMPLITUDE_REPEATS))
    off = abs(path.low_pass.delay_s - 1.0 / (2.0 * math.pi * 125e3))
    assert off < 3.5 * path.low_pass.delay_sigma_s
    assert 1e-10 < path.low_pass.delay_sigma_s < 2e-8, "1 % of 1.27 µs"


def test_an_ideal_path_has_neither_delay_nor_corner() -> None:
    path = fit_path(fundamentals(SPEEDS_HZ, 0.0, 0.0, 0.0, 1))
    assert path.cosine_delay_s == 0.0
    assert not path.corners.are_there
    assert not path.low_pass.is_detected
    assert path.low_pass.delay_s == 0.0
    assert 5e5 < path.low_pass.least_corner_hz < 5e6
    assert 1e-8 < path.low_pass.delay_sigma_s < 3e-7, "a low-pass beyond it would not be seen"


@each("ratio", [1.0, 1.02, 1.1])
def test_speeds_too_close_to_tell_are_refused(ratio: float) -> None:
    with pytest.raises(CalibrationError, match=r"too close|two speeds") as refused:
        fit_path(fundamentals((40_000.0, 40_000.0 * ratio), 1e-6, 0.0, 0.0))
    assert refused.value.reason == "speed"
    if ratio > 1.0:
        assert "ns" in str(refused.value)
        assert str(refused.value).count("cycle") >= 2


def test_speeds_just_apart_enough() -> None:
    path = fit_path(fundamentals((40_000.0, 48_000.0), 1e-6, 0.0, 0.0))
    off = abs(path.cosine_delay_s - 1e-6) * 2.0 * math.pi * 48_000.0
    assert off / (4.0 * math.pi * math.sqrt(2.0)) < MOST_UNCERTAIN_CYCLES


@each("wrong", [1000.0, -1000.0, 3000.0])
def test_a_speed_that_is_wrong_by_cycles_per_sample_does_not_fit(wrong: float) -> None:
    """Of three, one off by a cycle per millisecond: with a delay of 6 µs the line bends."""
    found = fundamentals((2541.0, 41_711.0, 125_041.0), 6e-6, 0.0, 0.0)
    found[1] = _moved(found[1], wrong)
    with pytest.raises(CalibrationError, match="speed right"):
        fit_path(found)


def _moved(one: Fundamental, hertz: float) -> Fundamental:
    return Fundamental(one.hertz + hertz, one.sine, one.cosine, one.angle_rad, one.noise)


@each("poles", [2, 3])
def test_more_poles_are_seen_by_three_speeds(poles: int) -> None:
    f = np.array(SPEEDS_HZ)
    amplitude = 1500.0 / np.hypot(1.0, f / 150e3) ** poles
    found = fit_low_pass(f, amplitude, np.full(4, AMPLITUDE_REPEATS))
    assert found.is_detected
    assert found.checked
    assert not found.is_one_pole
    assert found.may_have_two_poles == (poles == 2)
    assert found.other is not None
    if poles == 2:
        assert found.other.delay_s == pytest.approx(1.0 / (math.pi * 150e3), rel=1e-6)
        assert found.other.delay_s > 1.2 * found.delay_s


def test_two_speeds_do_not_tell_one_pole_from_two() -> None:
    f = np.array([2541.0, 125_041.0])
    found = fit_low_pass(f, 1500.0 / np.hypot(1.0, f / 125e3), np.full(2, AMPLITUDE_REPEATS))
    assert not found.checked
    assert found.may_have_two_poles
    several = np.array(SPEEDS_HZ)
    found = fit_low_pass(several, 1500.0 / np.hypot(1.0, several / 125e3), np.full(4, AMPLITUDE_REPEATS))
    assert not found.may_have_two_poles


def test_an_amplitude_that_rises_is_no_low_pass() -> None:
    f = np.array(SPEEDS_HZ)
    found = fit_low_pass(f, 1500.0 * np.hypot(1.0, f / 250e3), np.full(4, AMPLITUDE_REPEATS))
    assert not found.is_detected
    assert not found.is_one_pole


def test_both_directions_at_one_speed_tell_the_delay_alone() -> None:
    path = fit_path(fundamentals((-41_711.0, 41_711.0), 1e-7, 125e3, 125e3))
    assert path.cosine_delay_s == pytest.approx(1e-7, abs=3.0 * path.cosine_delay_sigma_s)
    assert not path.low_pass.is_detected
    assert not path.low_pass.checked
    assert path.low_pass.delay_sigma_s == math.inf


def test_the_angle_of_the_path() -> None:
    path: PathFit = fit_path(fundamentals(SPEEDS_HZ, 1e-7, 250e3, 225e3))
    f = 100e3
    true = 2.0 * math.pi * f * 1e-7 + math.atan(f / 250e3) - math.atan(f / 225e3)
    assert float(path.turned_rad(f)) == pytest.approx(true, abs=3e-4)
