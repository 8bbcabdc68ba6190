"""Right tables: speeds, motions, encoders, gaps, faults, uneven sample times."""

from __future__ import annotations

import numpy as np
import pytest
from measurements import (
    CYCLES_PER_REVOLUTION,
    PERCENT,
    RATE_HZ,
    extreme_encoder,
    random_encoder,
    table_error,
    wandering,
)

from canfb.calibration.from_motion import calibrate_from_motion
from canfb.calibration.result import Calibration
from canfb.signal.conditioning import Conditioning
from canfb.signal.phase import FloatArray
from canfb.simulation.encoder import Encoder, Harmonic


def _time(seconds: float) -> FloatArray:
    return np.arange(round(seconds * RATE_HZ)) / RATE_HZ


def _speeds(*points: tuple[float, float]) -> FloatArray:
    """Positions in cycles of a speed that is linear between these points (seconds, rpm)."""
    time = _time(points[-1][0])
    rpm = np.interp(time, [p[0] for p in points], [p[1] for p in points])
    return np.cumsum(rpm / 60.0 * CYCLES_PER_REVOLUTION) / RATE_HZ


def _check(result: Calibration, encoder: Encoder, goal: float) -> None:
    """The table is right, not suspiciously so, and does not claim more than is true."""
    peak = np.abs(table_error(result.table, encoder, result.conditioning)).max()
    assert 0.01 * goal < peak < goal
    assert peak < 1.3 * result.uncertainty_peak
    assert result.accepted
    assert result.reason == "accepted"


@pytest.mark.parametrize("rpm", [10.0, 60.0, 2000.0, 3000.0])
@pytest.mark.parametrize(("noise_lsb", "goal"), [(0.5, 0.002 * PERCENT), (1.2, 0.004 * PERCENT)])
@pytest.mark.parametrize("kind", [random_encoder, extreme_encoder])
def test_any_speed(kind, noise_lsb, goal, rpm):
    rng = np.random.default_rng([int(rpm), int(10 * noise_lsb)])
    encoder = kind(rng, noise_lsb)
    result = calibrate_from_motion(*encoder.sample(wandering(rpm, rng), rng))
    _check(result, encoder, goal)
    # Half of the goal is reached with ease.
    assert np.abs(table_error(result.table, encoder)).max() < goal / 2.0
    assert result.before_rms > 50.0 * result.residual_rms
    assert result.coverage == 1.0
    assert result.samples_used == 20000
    # Noise and rounding of a count.
    assert result.noise_counts == pytest.approx(np.hypot(noise_lsb, np.sqrt(1.0 / 12.0)), rel=0.05)


MOTIONS = {
    "ramp to 3000 rpm and back": _speeds((0.0, 0.0), (5.13, 3000.0), (10.0, 0.0)),
    "reversals": _speeds((0.0, 0.0), (2.03, 500.0), (5.11, -700.0), (8.0, 0.0)),
    "slow reversals": _speeds((0.0, 10.0), (4.0, -10.0), (8.0, 10.0)),
    "long standstill": _speeds((0.0, 0.0), (7.0, 0.0), (7.5, 60.0), (10.0, 90.0)),
    "swinging": 20.0 * np.sin(2.0 * np.pi * 0.9 * _time(10.0)),
}


@pytest.mark.parametrize("name", list(MOTIONS))
def test_any_motion(name):
    rng = np.random.default_rng(len(name))
    encoder = random_encoder(rng, 0.5)
    result = calibrate_from_motion(*encoder.sample(MOTIONS[name], rng))
    _check(result, encoder, 0.002 * PERCENT)


@pytest.mark.parametrize(
    ("size_cycles", "frequency_hz"), [(0.002, 47.0), (0.05, 47.0), (0.5, 47.0), (2.0, 10.0), (0.01, 110.0)]
)
def test_vibration_is_followed(size_cycles, frequency_hz):
    goal = 0.002 if frequency_hz < 100.0 else 0.01
    rng = np.random.default_rng(int(1000 * size_cycles))
    encoder = random_encoder(rng, 0.5)
    position = wandering(2000.0, rng, 6.0)
    position += size_cycles * np.sin(2.0 * np.pi * frequency_hz * _time(6.0))
    _check(calibrate_from_motion(*encoder.sample(position, rng)), encoder, goal * PERCENT)


def test_unsteady_positions_are_averaged_and_told():
    rng = np.random.default_rng(4)
    encoder = random_encoder(rng, 0.5)
    position = wandering(300.0, rng, 10.0)
    result = calibrate_from_motion(*encoder.sample(position + rng.normal(0.0, 3e-3, len(position)), rng))
    _check(result, encoder, 0.05 * PERCENT)
    assert result.noise_cycles == pytest.approx(3e-3, rel=0.1)
    assert result.residual_rms == pytest.approx(3e-3, rel=0.1)
    # Vibration is no noise of the tracks: the bound does not know it.
    assert result.noise_counts < 2.0
    assert result.cramer_rao_ratio is not None
    assert result.cramer_rao_ratio > 5.0


HIGH = (Harmonic(7, 0.01, 0.01), Harmonic(9, 0.005, 0.006, 1.0), Harmonic(11, 0.01, 0.008, 0.3, 0.2))
LARGE = (Harmonic(2, 0.08, 0.07, 1.0, 2.0), Harmonic(3, 0.1, 0.08, 0.2), Harmonic(5, 0.03, 0.04, 2.0))
ENCODERS = {
    "7th, 9th and 11th harmonic": Encoder(harmonics=HIGH, noise_lsb=0.5),
    "large harmonics": Encoder(harmonics=LARGE, noise_lsb=0.5),
    "phase error of 40 degrees": Encoder(phase_error_rad=0.7, noise_lsb=0.5),
    "16 bits": Encoder(amplitude_counts=25000.0, adc_bits=16, sine_offset=0.04, noise_lsb=5.0),
    "10 bits": Encoder(amplitude_counts=400.0, adc_bits=10, cosine_offset=0.04, noise_lsb=0.3),
}


@pytest.mark.parametrize("name", list(ENCODERS))
def test_any_encoder(name):
    rng = np.random.default_rng(len(name))
    encoder = ENCODERS[name]
    result = calibrate_from_motion(*encoder.sample(wandering(900.0, rng, 10.0), rng))
    _check(result, encoder, 0.003 * PERCENT)


def test_tracks_that_turn_backwards_give_a_table_that_fits():
    rng = np.random.default_rng(14)
    encoder = random_encoder(rng, 0.5)
    sine, cosine = encoder.sample(wandering(900.0, rng, 10.0), rng)
    plain, swapped = calibrate_from_motion(sine, cosine), calibrate_from_motion(cosine, sine)
    # Raw phase of swapped tracks is 1/4 less the raw phase, and so is the phase, but for a constant.
    raw = np.arange(1024) / 1024
    mirrored = plain.table(0.25 - raw) + swapped.table(raw)
    off = (mirrored - mirrored[0] + 0.5) % 1.0 - 0.5
    assert np.ptp(off) < 0.002 * PERCENT


@pytest.mark.parametrize("part", [0.01, 0.2])
def test_missed_samples_are_left_out(part):
    rng = np.random.default_rng(int(100 * part))
    encoder = random_encoder(rng, 0.5)
    sine, cosine = encoder.sample(wandering(2000.0, rng, 10.0), rng)
    valid = rng.random(len(sine)) > part
    marked = calibrate_from_motion(np.where(valid, sine, -5), np.where(valid, cosine, 0), valid=valid)
    _check(marked, encoder, 0.003 * PERCENT)
    assert marked.samples_used <= valid.sum()
    empty = calibrate_from_motion(np.where(valid, sine, np.nan), cosine)
    assert empty.table == marked.table


@pytest.mark.parametrize("part", [0.001, 0.01, 0.03])
def test_faults_that_nobody_marked_are_left_out(part):
    rng = np.random.default_rng(int(1000 * part))
    encoder = random_encoder(rng, 0.5)
    sine, cosine = encoder.sample(wandering(2000.0, rng, 10.0), rng)
    kind = rng.choice(4, len(sine), p=[1.0 - part, part / 3.0, part / 3.0, part / 3.0])
    late_s, late_c = np.roll(sine, 1), np.roll(cosine, 1)
    wild = rng.integers(-2000, 2000, len(sine))
    sine = np.select([kind == 1, kind == 2, kind == 3], [wild, 0, late_s], sine)
    cosine = np.select([kind == 2, kind == 3], [0, late_c], cosine)
    result = calibrate_from_motion(sine, cosine)
    _check(result, encoder, 0.003 * PERCENT)
    assert result.samples_rejected >= 0.8 * np.sum(kind != 0)


@pytest.mark.parametrize("jitter_s", [1e-6, 1e-4])
@pytest.mark.parametrize("from_rest", [False, True])
def test_uneven_sample_times_are_used(jitter_s, from_rest):
    rng = np.random.default_rng(int(from_rest))
    encoder = random_encoder(rng, 0.5)
    time = _time(10.0) + rng.uniform(-jitter_s, jitter_s, 10000)
    speed = 2000.0 / 60.0 * CYCLES_PER_REVOLUTION
    position = speed * (time + 0.03 * np.sin(4.3 * time) / 4.3)
    if from_rest:
        position = np.where(time < 2.03, speed * time**2 / 4.06, speed * (time - 1.015))
        position += 20.0 * np.sin(4.3 * time)
    sine, cosine = encoder.sample(position, rng)
    _check(calibrate_from_motion(sine, cosine, time_s=time + 77.7), encoder, 0.002 * PERCENT)


@pytest.mark.parametrize("kind", [random_encoder, extreme_encoder])
def test_conditioning_is_fitted_used_and_left(kind):
    rng = np.random.default_rng(10)
    encoder = kind(rng, 0.5)
    sine, cosine = encoder.sample(wandering(700.0, rng, 10.0), rng)
    fitted = calibrate_from_motion(sine, cosine, "fit")
    _check(fitted, encoder, 0.002 * PERCENT)
    given = calibrate_from_motion(sine, cosine, fitted.conditioning)
    assert given.conditioning == fitted.conditioning
    assert given.table == fitted.table
    left = calibrate_from_motion(sine, cosine)
    assert left.conditioning == Conditioning()
    assert left.before_rms > fitted.before_rms > 5e-3
    assert left.harmonics[0].amplitude_cycles > sum(h.amplitude_cycles for h in fitted.harmonics[:1])


def test_tracks_that_do_not_circle_the_origin_need_the_fit():
    rng = np.random.default_rng(11)
    encoder = Encoder(amplitude_counts=800.0, sine_offset=1.2, noise_lsb=0.5)
    tracks = encoder.sample(wandering(700.0, rng, 10.0), rng)
    result = calibrate_from_motion(*tracks, "fit")
    _check(result, encoder, 0.004 * PERCENT)


def test_progress_rises_to_one():
    rng = np.random.default_rng(13)
    seen: list[float] = []
    tracks = Encoder(noise_lsb=0.5).sample(wandering(60.0, rng, 2.0), rng)
    calibrate_from_motion(*tracks, progress=seen.append)
    assert len(seen) >= 3
    assert seen == sorted(seen)
    assert seen[0] >= 0.0
    assert seen[-1] == 1.0
