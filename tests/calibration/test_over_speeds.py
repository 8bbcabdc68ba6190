"""One encoder at several speeds: table, delay and corners, and how uncertain they are."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from measurements import CYCLES_PER_REVOLUTION, RATE_HZ

from canfb import CalibrationError, ChainConfig, Sample, SignalChain
from canfb.calibration.over_speeds import (
    SpeedCalibration,
    TracksAtSpeed,
    calibrate_over_speeds,
    standing_waveform,
)
from canfb.calibration.path_fit import AMPLITUDE_REPEATS, Fundamental, PathFit, fit_low_pass, fit_path
from canfb.signal.front_end import Corners
from canfb.signal.phase import FloatArray
from canfb.simulation.encoder import AnalogPath, Encoder, Harmonic
from folding import each


def machine_with(**path: float) -> Encoder:
    """An encoder, and what is behind it."""
    return Encoder(
        amplitude_counts=1475.0, sine_offset=0.024, cosine_offset=-0.014, sine_amplitude=1.024,
        cosine_amplitude=0.976, phase_error_rad=0.05, path=AnalogPath(**path), noise_lsb=0.5,
        harmonics=(Harmonic(2, 0.004, 0.0, 1.6), Harmonic(3, 0.01, 0.01, 0.4, -1.1)),
    )  # fmt: skip


def at_speed(
    machine: Encoder, rpm: float, samples: int, seed: int, ripple: float = 1e-3
) -> tuple[TracksAtSpeed, FloatArray]:
    """Counts at this speed, which ripples, and the true positions in cycles."""
    rng = np.random.default_rng(seed)
    hertz = (
        rpm
        / 60.0
        * CYCLES_PER_REVOLUTION
        * (1.0 + ripple * np.sin(2.0 * np.pi * 0.83 * np.arange(samples) / RATE_HZ))
    )
    position = rng.uniform() + np.cumsum(hertz) / RATE_HZ
    sine, cosine = (track.astype(np.float64) for track in machine.sample(position, rng, hertz))
    return TracksAtSpeed(sine, cosine, RATE_HZ, float(np.mean(hertz))), position


SAMPLES = 1600
NOISE = 0.5 / (2.0 * math.pi * 1475.0)  # of a sample, cycles
IDEAL = machine_with()
PATHS = {
    "multiplexer": machine_with(cosine_delay_s=1e-6),
    "low-pass": machine_with(sine_corner_hz=125e3, cosine_corner_hz=125e3),
    "all": machine_with(cosine_delay_s=1e-7, sine_corner_hz=250e3, cosine_corner_hz=255e3),
}


def errors(machine: Encoder, found: SpeedCalibration, rpm: float) -> FloatArray:
    """Of the chain with what was found, cycles, mean included; samples that were not measured with."""
    samples, position = at_speed(machine, rpm, 1200, 99)
    config = ChainConfig(
        conditioning=found.calibration.conditioning,
        corner_hz=found.path.corners.corner_hz,
        cosine_corner_hz=found.path.corners.cosine_corner_hz,
        interval_s=1.0 / RATE_HZ,
    )
    chain = SignalChain(config, found.calibration.table)
    chain.restart(0, samples.hertz / RATE_HZ)
    off = []
    for sine, cosine, true in zip(samples.sine, samples.cosine, position, strict=True):
        got = chain.step(Sample(float(sine), float(cosine)))
        off.append(got.cycles - true + got.phase + chain.tracks.lag_intervals * got.speed_cycles)
    kept = np.array(off[60:])
    return np.asarray(kept - np.round(np.median(kept)), np.float64)


@each("name, measured_rpm, ripple", [
    *((name, (61.0, 703.0, 3001.0), 1e-3) for name in PATHS),
    ("all", (61.0, 3001.0), 0.03),  # a speed that varies is moved to its mean
    ("all", (903.0, 3001.0), 1e-3),  # the lowest need not be low
])  # fmt: skip
def test_the_error_is_noise_at_each_speed(name: str, measured_rpm: tuple[float, ...], ripple: float) -> None:
    machine = PATHS[name]
    measured = [at_speed(machine, rpm, SAMPLES, seed, ripple)[0] for seed, rpm in enumerate(measured_rpm)]
    found = calibrate_over_speeds(measured, adc_bits=12)
    path, true = found.path, machine.path
    assert path.cosine_delay_s == pytest.approx(true.cosine_delay_s, abs=2e-9 if ripple > 0.01 else 1e-9)
    assert found.calibration.conditioning.phase_error_rad == pytest.approx(machine.phase_error_rad, abs=5e-3)
    if len(measured_rpm) == 3:
        assert path.corners.corner_hz == pytest.approx(true.sine_corner_hz, rel=5e-3)
        assert path.corners.of_cosine_hz == pytest.approx(true.cosine_corner_hz, rel=5e-3)
    late = found.with_delay(path.low_pass.delay_s)
    for rpm in (60.0, 1511.0, 2999.0):
        off = errors(machine, late, rpm)
        assert 0.7 * NOISE < off.std() < 3e-4
        assert abs(off.mean()) < 3e-3, "the sine's origin is that of the fundamental"
    if true.sine_corner_hz:
        assert errors(machine, found, 2999.0).mean() < -0.06, "without 2002:07 it is late"


SLOW = at_speed(IDEAL, 61.0, SAMPLES, 1)[0]
STILL = TracksAtSpeed(np.full(SAMPLES, 300.0), np.full(SAMPLES, 900.0), RATE_HZ, 0.0)


@each("measured, error, message", [
    ([SLOW], CalibrationError, "at least two different speeds"),
    ([SLOW, STILL], CalibrationError, "at 0 cycles/s: the tracks hardly change"),
    ([SLOW, at_speed(IDEAL, 1200.0, SAMPLES, 2, ripple=0.2)[0]], CalibrationError, "not one speed"),
    ([SLOW, replace(SLOW, hertz=math.nan)], ValueError, "finite"),
])  # fmt: skip
def test_what_shows_no_path_is_refused(
    measured: list[TracksAtSpeed], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        calibrate_over_speeds(measured)


# The arithmetic, against the simulation of the encoder, which has another one.


@given(
    st.floats(-3e5, 3e5),
    st.floats(-1e-6, 1e-6),
    st.one_of(st.just(0.0), st.floats(5e4, 1e6)),
    st.floats(0.8, 1.2),
    st.floats(0.0, 0.05),
)
def test_tracks_at_speed_come_back_to_standstill(
    hertz: float, delay_s: float, corner_hz: float, apart: float, third: float
) -> None:
    path = AnalogPath(sine_corner_hz=corner_hz, cosine_corner_hz=apart * corner_hz, cosine_delay_s=delay_s)
    encoder = Encoder(
        sine_offset=0.02,
        phase_error_rad=0.1,
        harmonics=(Harmonic(2, 0.01, 0.0, 0.3), Harmonic(3, third, 0.01, 0.0, 1.0)),
        path=path,
    )
    grid = np.arange(256) / 256
    moved = np.array(encoder.tracks(grid, hertz))
    found = standing_waveform(moved, (1, 2, 3), hertz, delay_s, Corners(corner_hz, apart * corner_hz))
    assert np.array(found.tracks(grid)) == pytest.approx(np.array(encoder.tracks(grid, 0.0)), abs=1e-8)


FUNDAMENTAL_NOISE = 1e-5
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
        off = 1.0 + FUNDAMENTAL_NOISE * rng.normal(size=3)
        found.append(
            Fundamental(
                f, abs(s) * both * off[0], abs(c) * both * off[1], angle + off[2] - 1.0, FUNDAMENTAL_NOISE
            )
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
    with pytest.raises(CalibrationError, match=r"too close|two different speeds") as refused:
        fit_path(fundamentals((40_000.0, 40_000.0 * ratio), 1e-6, 0.0, 0.0))
    assert refused.value.reason == "speed"
    if ratio > 1.0:
        assert "ns" in str(refused.value)
        assert str(refused.value).count("cycle") >= 2


@each("wrong", [1000.0, -1000.0, 3000.0])
def test_a_speed_that_is_wrong_by_cycles_per_sample_does_not_fit(wrong: float) -> None:
    """Of three, one off by a cycle per millisecond: with a delay of 6 µs the line bends."""
    found = fundamentals((2541.0, 41_711.0, 125_041.0), 6e-6, 0.0, 0.0)
    found[1] = found[1]._replace(hertz=found[1].hertz + wrong)
    with pytest.raises(CalibrationError, match="speed right"):
        fit_path(found)


@each("poles", [2, 3])
def test_more_poles_are_seen_by_three_speeds(poles: int) -> None:
    f = np.array(SPEEDS_HZ)
    amplitude = 1500.0 / np.hypot(1.0, f / 150e3) ** poles
    found = fit_low_pass(f, amplitude, np.full(4, AMPLITUDE_REPEATS))
    assert found.is_detected
    assert found.checked
    assert not found.is_one_pole
    delay_s = found.two_poles_delay_s
    assert (delay_s is not None) == (poles == 2)
    if delay_s is not None:
        assert delay_s == pytest.approx(1.0 / (math.pi * 150e3), rel=1e-6)
        assert delay_s > 1.2 * found.delay_s


def test_two_speeds_do_not_tell_one_pole_from_two() -> None:
    f = np.array([2541.0, 125_041.0])
    found = fit_low_pass(f, 1500.0 / np.hypot(1.0, f / 125e3), np.full(2, AMPLITUDE_REPEATS))
    assert not found.checked
    assert found.two_poles_delay_s is not None
    several = np.array(SPEEDS_HZ)
    found = fit_low_pass(several, 1500.0 / np.hypot(1.0, several / 125e3), np.full(4, AMPLITUDE_REPEATS))
    assert found.two_poles_delay_s is None


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
