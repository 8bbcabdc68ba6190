from __future__ import annotations

import math

import numpy as np
import pytest

from canfb.calibration.ellipse import fit_ellipse
from canfb.errors import CalibrationError
from canfb.signal.conditioning import Conditioning
from canfb.simulation.encoder import Encoder


def _encoder(rng: np.random.Generator, noise_lsb: float = 0.5) -> Encoder:
    return Encoder(
        amplitude_counts=rng.uniform(600.0, 1200.0),
        sine_offset=rng.uniform(-0.5, 0.5),
        cosine_offset=rng.uniform(-0.5, 0.5),
        sine_amplitude=rng.uniform(0.7, 1.3),
        cosine_amplitude=rng.uniform(0.7, 1.3),
        phase_error_rad=rng.uniform(-0.6, 0.6),
        noise_lsb=noise_lsb,
    )


def _error(found: Conditioning, encoder: Encoder) -> tuple[float, float, float]:
    """Errors of the offsets in counts, of the ratio of the gains, and of the phase error in radians."""
    a = encoder.amplitude_counts
    offset = math.hypot(
        found.sine_offset_counts - a * encoder.sine_offset,
        found.cosine_offset_counts - a * encoder.cosine_offset,
    )
    ratio = found.cosine_gain / found.sine_gain * encoder.cosine_amplitude / encoder.sine_amplitude
    return offset, abs(ratio - 1.0), abs(found.phase_error_rad - encoder.phase_error_rad)


@pytest.mark.parametrize("seed", range(6))
def test_offset_gain_and_phase_are_found(seed):
    rng = np.random.default_rng(seed)
    encoder = _encoder(rng)
    found = fit_ellipse(*encoder.sample(rng.random(5000), rng))
    offset, ratio, phase = _error(found, encoder)
    # Half a count of noise in 5000 samples.
    assert 1e-5 < offset < 0.1
    assert ratio < 2e-4
    assert phase < 2e-4


def test_faults_are_left_out():
    rng = np.random.default_rng(8)
    encoder = _encoder(rng)
    sine, cosine = encoder.sample(rng.random(5000), rng)
    at = rng.random(5000) < 0.15
    sine[at] = rng.integers(-2048, 2048, at.sum())
    cosine[at & (rng.random(5000) < 0.5)] = 0
    offset, ratio, phase = _error(fit_ellipse(sine, cosine), encoder)
    assert offset < 3.0
    assert max(ratio, phase) < 3e-3


def test_a_long_standstill_does_not_weigh():
    rng = np.random.default_rng(13)
    encoder = _encoder(rng)
    position = np.append(np.full(20000, 0.17), rng.random(2000))
    offset, ratio, phase = _error(fit_ellipse(*encoder.sample(position, rng)), encoder)
    assert offset < 0.3
    assert max(ratio, phase) < 5e-4


def _bad_tracks() -> dict[str, tuple[np.ndarray, np.ndarray, str]]:
    rng = np.random.default_rng(12)
    x = 2.0 * np.pi * rng.random(4000)
    sine, still = 1000.0 * np.sin(x), np.full(4000, 500.0)
    noise = rng.normal(0.0, 300.0, (2, 4000))
    even = rng.uniform(-1000.0, 1000.0, (2, 4000))
    three = np.arange(4000) * 2.0 * np.pi / 3.0
    locked = rng.normal(1000.0 * np.array([np.sin(three), np.cos(three)]), 0.5)
    return {
        "standstill": (still, still, "coverage"),
        "dead track": (sine, still, "ellipse"),
        "short circuit": (sine, sine, "ellipse"),
        "inverted short circuit": (sine, rng.normal(-sine, 2.0), "ellipse"),
        "noise": (*noise, "ellipse"),
        "evenly random": (*even, "ellipse"),
        "locked": (*locked, "locked"),
    }


@pytest.mark.parametrize("name", list(_bad_tracks()))
def test_what_is_no_ellipse_is_refused(name):
    sine, cosine, reason = _bad_tracks()[name]
    with pytest.raises(CalibrationError) as refused:
        fit_ellipse(np.rint(sine), np.rint(cosine))
    assert refused.value.reason == reason


def test_too_few_samples_and_wrong_shapes():
    with pytest.raises(CalibrationError) as refused:
        fit_ellipse(np.arange(10), np.arange(10))
    assert refused.value.reason == "samples"
    with pytest.raises(ValueError, match="one length"):
        fit_ellipse(np.arange(10), np.arange(11))
