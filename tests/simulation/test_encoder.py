"""The simulated encoder, and its analog path, against their formulas."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.signal.phase import phase_in_cycle
from canfb.simulation.encoder import AnalogPath, Encoder, Harmonic, ShaftEncoder, demo_encoder
from canfb.simulation.motion import Motion
from folding import each

HARMONICS = (Harmonic(2, 0.01, 0.02, 0.4, 1.1), Harmonic(5, 0.0, 0.03))
BENT = Encoder(
    amplitude_counts=1400.0,
    sine_offset=0.04,
    cosine_offset=-0.03,
    sine_amplitude=1.03,
    cosine_amplitude=0.96,
    phase_error_rad=0.05,
    harmonics=HARMONICS,
)


def by_the_formulas(position: float) -> tuple[float, float]:
    """BENT written out once more, with math and one number at a time."""
    x = 2 * math.pi * position
    sine = math.sin(x) + 0.01 * math.sin(2 * x + 0.4)
    cosine = math.cos(x - 0.05) + 0.02 * math.cos(2 * x + 1.1) + 0.03 * math.cos(5 * x)
    return 1400 * (0.04 + 1.03 * sine), 1400 * (-0.03 + 0.96 * cosine)


@given(st.floats(-100, 100))
def test_tracks_are_those_of_the_formulas_and_samples_are_rounded_to_counts(position: float) -> None:
    want = by_the_formulas(position)
    assert tuple(map(float, BENT.tracks(position))) == pytest.approx(want, abs=1e-7)
    sine, cosine = BENT.sample(position)
    assert max(abs(sine - want[0]), abs(cosine - want[1])) <= 0.5 + 1e-6
    assert sine.dtype == cosine.dtype == np.int64


def test_without_errors_the_raw_phase_is_that_of_table_1() -> None:
    positions = (np.arange(1000) + 0.5) / 1000
    raw = phase_in_cycle(*Encoder().tracks(positions))
    error = np.abs(raw - positions)
    # The paper: 1.132 % of a cycle for ideal tracks; more or less would be other tracks.
    assert 0.0112 < error.max() < 0.0114


@each("adc_bits", [4, 12, 16])
def test_the_converter_holds_at_both_ends(adc_bits: int) -> None:
    full = 1 << (adc_bits - 1)
    encoder = Encoder(amplitude_counts=2.0 * full, adc_bits=adc_bits)
    sine, cosine = encoder.sample([0.25, 0.75, 0.0, 0.5])
    assert sine.tolist() == [full - 1, -full, 0, 0]
    assert cosine.tolist() == [0, 0, full - 1, -full]
    just = Encoder(amplitude_counts=full - 1.0, adc_bits=adc_bits)
    assert just.sample(0.25)[0] == full - 1
    assert just.sample(0.75)[0] == 1 - full


def test_the_noise_has_the_strength_that_was_asked_for() -> None:
    """Gaussian before the converter, whose rounding adds 1/12 count squared; bounded on both sides."""
    encoder = Encoder(noise_lsb=0.8)
    positions = np.linspace(0, 1, 20_000)
    analog = np.array(encoder.tracks(positions))
    noise = np.array(encoder.sample(positions, np.random.default_rng(5))) - analog
    want = math.sqrt(0.8**2 + 1 / 12)
    assert np.std(noise, axis=1) == pytest.approx([want, want], rel=0.02)
    assert abs(noise.mean()) < 0.02
    assert abs(np.corrcoef(noise[0], noise[1])[0, 1]) < 0.03, "the tracks have noise of their own"
    assert abs(np.corrcoef(noise[0, 1:], noise[0, :-1])[0, 1]) < 0.03, "white"
    beyond = np.count_nonzero(np.abs(noise) > 3 * want) / noise.size
    assert 0.0005 < beyond < 0.006, "as often beyond three sigma as a Gaussian"


def test_without_a_generator_or_with_strength_zero_there_is_no_noise() -> None:
    quiet, loud = Encoder(), Encoder(noise_lsb=50.0)
    positions = np.linspace(0, 1, 100)
    want = np.array(quiet.sample(positions))
    assert np.array_equal(loud.sample(positions), want)
    assert np.array_equal(quiet.sample(positions, np.random.default_rng(1)), want)
    noisy = [np.array(loud.sample(positions, np.random.default_rng(seed))) for seed in (1, 1, 2)]
    assert np.array_equal(noisy[0], noisy[1])
    assert not np.array_equal(noisy[1], noisy[2])
    assert not np.array_equal(noisy[0], want)


def test_the_encoder_of_the_demo_is_mediocre_but_not_clipped() -> None:
    encoder = demo_encoder()
    sine, cosine = encoder.sample(np.linspace(0, 1, 5000), np.random.default_rng(1))
    for track in (sine, cosine):
        assert -2047 < track.min() < -1300
        assert 1300 < track.max() < 2046
    assert abs(sine.mean()) > 40
    assert abs(cosine.mean()) > 30


HERTZ = 125e3


def one_pole(track: np.ndarray, step_s: float, corner_hz: float) -> np.ndarray:
    """The exact response of a low-pass to a track that is held between its points."""
    part = 1.0 - math.exp(-2.0 * math.pi * corner_hz * step_s)
    out, value = np.empty(len(track)), float(track[0])
    for k, held in enumerate(track.tolist()):
        out[k] = value
        value += part * (held - value)
    return out


def test_the_steady_response_is_that_of_the_filter() -> None:
    step_s = 1e-9
    time = np.arange(80_000) * step_s
    plain = Encoder(harmonics=(Harmonic(3, 0.05, 0.03, 0.4, 1.0),), sine_offset=0.1)
    path = AnalogPath(sine_corner_hz=125e3, cosine_corner_hz=80e3, cosine_delay_s=1e-6)
    sine, cosine = plain.tracks(HERTZ * time)
    wanted = one_pole(sine, step_s, 125e3), one_pole(cosine, step_s, 80e3)
    steady = Encoder(harmonics=plain.harmonics, sine_offset=0.1, path=path)
    at = slice(50_000, 78_000)
    ours = steady.tracks(HERTZ * time[at], HERTZ)
    assert ours[0] == pytest.approx(wanted[0][at], abs=3.0)  # of 1500 counts, 1 ns
    assert ours[1] == pytest.approx(wanted[1][51_000:79_000], abs=3.0)


@pytest.mark.parametrize(
    "path", [AnalogPath(sine_corner_hz=125e3, cosine_corner_hz=125e3), AnalogPath(delay_s=2e-6)]
)
def test_the_lag_is_that_of_the_phase(path: AnalogPath) -> None:
    encoder = Encoder(path=path)
    sine, cosine = encoder.tracks(0.3, HERTZ)
    shown = math.atan2(float(sine), float(cosine)) / (2.0 * math.pi) % 1.0
    assert 0.3 - shown == pytest.approx(HERTZ * path.lag_s(HERTZ), abs=1e-12)
    assert path.lag_s(0.0) == pytest.approx(path.lag_s(1.0), rel=1e-6)


def test_a_shaft_knows_its_speed() -> None:
    path = AnalogPath(sine_corner_hz=125e3, cosine_corner_hz=125e3)
    shaft = ShaftEncoder(Encoder(path=path), 2500)
    motion = Motion((), start_rpm=3000.0)
    amplitudes = [math.hypot(*shaft.sample(k * 1e-3, motion.revolutions)[:2]) for k in range(1, 20)]
    assert np.mean(amplitudes) == pytest.approx(1500.0 / math.sqrt(2.0), rel=1e-3)
