"""One encoder at several speeds: table, delay and corners against paths that are simulated in time."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from analog_speeds import RATE_HZ, Machine, low_passed
from hypothesis import given
from hypothesis import strategies as st

from canfb.calibration.over_speeds import (
    SpeedCalibration,
    TracksAtSpeed,
    calibrate_over_speeds,
    standing_waveform,
)
from canfb.errors import CalibrationError
from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import ChainConfig
from canfb.signal.harmonics import Corners
from canfb.signal.phase import FloatArray
from canfb.signal.sample import Sample
from canfb.simulation.encoder import AnalogPath, Encoder, Harmonic
from folding import each

SAMPLES = 1600
NOISE = 0.5 / (2.0 * math.pi * 1475.0)  # of a sample, cycles
PATHS = {
    "multiplexer": Machine(cosine_delay_s=1e-6),
    "low-pass": Machine(corner_hz=125e3),
    "all": Machine(cosine_delay_s=1e-7, corner_hz=250e3, cosine_corner_hz=255e3),
}


def calibrated(machine: Machine, *rpm: float, ripple: float = 1e-3) -> SpeedCalibration:
    measured = [machine.at(one, SAMPLES, seed, ripple)[0] for seed, one in enumerate(rpm)]
    return calibrate_over_speeds(measured, adc_bits=12)


def errors(machine: Machine, found: SpeedCalibration, rpm: float) -> FloatArray:
    """Of the chain with what was found, cycles, mean included; samples that were not measured with."""
    samples, position = machine.at(rpm, 1200, 99)
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


@each("name", list(PATHS))
def test_the_error_is_noise_at_each_speed(name: str) -> None:
    machine = PATHS[name]
    found = calibrated(machine, 61.0, 703.0, 3001.0)
    path = found.path
    assert path.cosine_delay_s == pytest.approx(machine.cosine_delay_s, abs=1e-9)
    assert path.corners.corner_hz == pytest.approx(machine.corner_hz, rel=5e-3)
    assert path.corners.of_cosine_hz == pytest.approx(machine.cosine_corner_hz or machine.corner_hz, rel=5e-3)
    late = found.with_delay(path.low_pass.delay_s)
    for rpm in (60.0, 1511.0, 2999.0):
        off = errors(machine, late, rpm)
        assert 0.7 * NOISE < off.std() < 3e-4
        assert abs(off.mean()) < 3e-3, "the sine's origin is that of the fundamental"
    if machine.corner_hz:
        assert errors(machine, found, 2999.0).mean() < -0.06, "without 2002:07 it is late"


def test_a_speed_that_varies_is_moved_to_its_mean() -> None:
    machine = PATHS["all"]
    found = calibrated(machine, 61.0, 3001.0, ripple=0.03)
    assert found.path.cosine_delay_s == pytest.approx(1e-7, abs=2e-9)
    assert errors(machine, found, 2999.0).std() < 3e-4


def test_the_lowest_speed_need_not_be_low() -> None:
    machine = PATHS["all"]
    found = calibrated(machine, 903.0, 3001.0)
    for rpm in (60.0, 2999.0):
        assert 0.7 * NOISE < errors(machine, found, rpm).std() < 3e-4
    assert found.calibration.conditioning.phase_error_rad == pytest.approx(machine.phase_error, abs=5e-3)


def test_one_speed_shows_no_path() -> None:
    with pytest.raises(CalibrationError, match="at least two speeds"):
        calibrated(PATHS["all"], 703.0)


def test_a_bad_measurement_says_at_which_speed() -> None:
    slow, _ = Machine().at(61.0, SAMPLES, 1)
    still = TracksAtSpeed(np.full(SAMPLES, 300.0), np.full(SAMPLES, 900.0), RATE_HZ, 0.0)
    with pytest.raises(CalibrationError, match="at 0 cycles/s: the tracks hardly change"):
        calibrate_over_speeds([slow, still])


def test_a_sweep_is_not_one_speed() -> None:
    slow, _ = Machine().at(61.0, SAMPLES, 1)
    fast, _ = Machine().at(1200.0, SAMPLES, 2, ripple=0.2)
    with pytest.raises(CalibrationError, match="not one speed"):
        calibrate_over_speeds([slow, fast])


def test_speeds_must_be_numbers() -> None:
    slow, _ = Machine().at(61.0, SAMPLES, 1)
    with pytest.raises(ValueError, match="finite"):
        calibrate_over_speeds([slow, replace(slow, hertz=math.nan)])


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


@each("hertz", [20e3, 125e3, -125e3])
def test_the_simulation_in_time_is_a_low_pass(hertz: float) -> None:
    x = 2.0 * np.pi * np.arange(8193) / 8192
    found = low_passed(np.sin(x), hertz, 125e3)
    ratio = hertz / 125e3
    assert found == pytest.approx(np.sin(x - math.atan(ratio)) / math.hypot(1.0, ratio), abs=1e-6)
