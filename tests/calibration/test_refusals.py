"""A bad measurement is refused with the reason, never returned as good."""

from __future__ import annotations

import numpy as np
import pytest
from measurements import random_encoder, table_error, wandering

from canfb.calibration.from_motion import calibrate_from_motion
from canfb.calibration.result import Reason
from canfb.calibration.zero_crossing import calibrate_from_zero_crossings
from canfb.errors import CalibrationError, CanfbError
from canfb.signal.phase import FloatArray
from canfb.simulation.encoder import Encoder

N = 6000


def _reason(sine, cosine, method=calibrate_from_motion, **options) -> str:
    with pytest.raises(CalibrationError) as refused:
        method(sine, cosine, **options)
    error = refused.value
    assert isinstance(error, CanfbError)
    assert error.reason in list(Reason)
    assert len(str(error)) > 20
    if error.calibration is not None:
        assert not error.calibration.accepted
        assert error.calibration.reason == error.reason
        assert error.calibration.verdict.startswith("refused")
    return error.reason


def _tracks(position: FloatArray, seed: int = 1, noise_lsb: float = 0.5):
    rng = np.random.default_rng(seed)
    return random_encoder(rng, noise_lsb).sample(position, rng)


def test_standstill_and_short_ways():
    assert _reason(*_tracks(np.full(N, 0.3))) == "coverage"
    assert _reason(*_tracks(np.linspace(0.0, 0.6, N))) == "coverage"
    assert _reason(*_tracks(np.linspace(0.0, 6.0, N))) == "cycles"


@pytest.mark.parametrize("speed", [1.0, 83.0, 1 / 2, 1 / 3, 2 / 7, 0.125, 1.0 / 16.0])
def test_motion_locked_to_the_samples(speed):
    # A whole number of cycles per sample cannot be told from standstill.
    expected = "coverage" if speed == int(speed) else "locked"
    assert _reason(*_tracks(speed * np.arange(N) + 0.1)) == expected


@pytest.mark.parametrize("speed", [1.0, 0.5, 1 / 3])
def test_motion_that_creeps_away_from_the_lock(speed):
    assert _reason(*_tracks((speed + 2e-5) * np.arange(N))) in ("locked", "coverage", "cycles", "ellipse")


def test_clipped_tracks():
    rng = np.random.default_rng(2)
    position = wandering(300.0, rng, 6.0)
    for amplitude in (2070.0, 2600.0, 10000.0):
        assert _reason(*Encoder(amplitude_counts=amplitude, noise_lsb=0.5).sample(position, rng)) == "clipped"
    near = Encoder(amplitude_counts=2040.0, noise_lsb=0.5)
    assert np.abs(table_error(calibrate_from_motion(*near.sample(position, rng)).table, near)).max() < 3e-5
    small = Encoder(amplitude_counts=540.0, adc_bits=10, noise_lsb=0.5).sample(position, rng)
    assert _reason(*small, adc_bits=10) == "clipped"


def test_samples_beyond_the_converter_are_a_wrong_argument():
    with pytest.raises(ValueError, match="adc_bits"):
        calibrate_from_motion(*Encoder().sample(np.arange(1000) * 0.1), adc_bits=8)


def test_noise():
    rng = np.random.default_rng(3)
    position = wandering(300.0, rng, 6.0)
    assert _reason(*_tracks(position, noise_lsb=300.0)) == "noise"
    assert _reason(*_tracks(position + rng.normal(0.0, 0.06, len(position)))) == "noise"
    assert _reason(*_tracks(rng.uniform(0.0, 50.0, N))) == "noise"
    # A jitter of 20 us of the samples is 1.7 cycles at 83 cycles per sample.
    time = np.arange(N) / 1000.0 + rng.normal(0.0, 2e-5, N)
    assert _reason(*_tracks(83000.0 * (time + 0.03 * np.sin(time)))) == "noise"


def test_accelerations_that_no_tracker_follows():
    # Eq. 10 at 1 kHz allows half a cycle per sample squared; this is three times as much, to and fro.
    assert _reason(*_tracks(15.0 * np.sin(np.arange(N) * 0.317))) in ("noise", "locked")


def test_tracks_that_do_not_circle_the_origin():
    rng = np.random.default_rng(4)
    encoder = Encoder(amplitude_counts=800.0, cosine_offset=1.15, noise_lsb=0.5)
    sine, cosine = encoder.sample(wandering(300.0, rng, 6.0), rng)
    assert _reason(sine, cosine) == "monotonic"


def test_broken_tracks():
    rng = np.random.default_rng(5)
    sine, cosine = _tracks(wandering(300.0, rng, 6.0))
    for method in (calibrate_from_motion, calibrate_from_zero_crossings):
        assert _reason(sine, 0 * cosine, method) == "ellipse"
        assert _reason(sine, sine, method) == "ellipse"
        assert _reason(rng.normal(0.0, 300.0, N), rng.normal(0.0, 300.0, N), method) == "ellipse"


def test_too_few_samples():
    sine, cosine = _tracks(np.arange(float(N)) * 0.31)
    for method in (calibrate_from_motion, calibrate_from_zero_crossings):
        assert _reason(sine[:150], cosine[:150], method) == "samples"
        assert _reason([], [], method) == "samples"
        assert _reason(sine, np.full(N, np.nan), method) == "samples"
        assert _reason(sine, cosine, method, valid=np.zeros(N, np.bool_)) == "samples"


def _random_motion(rng: np.random.Generator, n: int) -> FloatArray:
    time = np.arange(n) / 1000.0
    speed = 10.0 ** rng.uniform(-1.0, 5.0)
    kind = rng.integers(0, 4)
    if kind == 0:
        return speed * time
    if kind == 1:
        corners = np.sort(rng.uniform(0.0, time[-1], 5))
        return np.cumsum(np.interp(time, corners, speed * rng.normal(size=5))) / 1000.0
    if kind == 2:
        size, frequency = 10.0 ** rng.uniform(-1.0, 2.0), 10.0 ** rng.uniform(-1.0, 1.5)
        return size * np.sin(2.0 * np.pi * frequency * time)
    return wandering(speed / 42.0, rng, n / 1000.0) + rng.normal(0.0, 10.0 ** rng.uniform(-5.0, -1.0), n)


@pytest.mark.parametrize("seed", range(20))
def test_what_is_accepted_is_as_good_as_it_says(seed):
    rng = np.random.default_rng(1000 + seed)
    encoder = random_encoder(rng, 10.0 ** rng.uniform(-0.5, 1.0))
    n = int(10.0 ** rng.uniform(2.5, 3.7))
    sine, cosine = encoder.sample(_random_motion(rng, n), rng)
    faulty = rng.random(n) < 10.0 ** rng.uniform(-5.0, -1.7)
    sine[faulty] = rng.integers(-2000, 2000, faulty.sum())
    try:
        result = calibrate_from_motion(sine, cosine)
    except CalibrationError:
        return
    assert np.abs(table_error(result.table, encoder)).max() < 2.0 * result.uncertainty_peak
    assert result.uncertainty_rms < 5e-4
