"""The tracks of an encoder as a waveform with its table, and as an ellipse with its conditioning."""

import math

import numpy as np
import pytest
from measurements import random_encoder, refusal

from canfb.calibration.ellipse import fit_ellipse
from canfb.calibration.joint import (
    Waveform,
    basis,
    grid_phases,
    raw_phase_curve,
    table_from_phases,
    table_sensitivity,
)
from canfb.signal.conditioning import Conditioning
from canfb.simulation.encoder import Encoder

ORDERS = (1, 2, 3, 5)


def test_sensitivity_is_the_change_of_the_table():
    """The waveform is the encoder's tracks as a Fourier series, by least squares over one cycle."""
    position = np.arange(512) / 512
    tracks = np.column_stack(random_encoder(np.random.default_rng(6), 0.0).tracks(position))
    solution = np.linalg.lstsq(basis(position, ORDERS), tracks, rcond=None)[0].astype(np.float64)
    waveform = Waveform(ORDERS, solution.T)
    conditioning = Conditioning(15.0, 5.0, 0.95, 1.05, -0.08)
    sensitivity = table_sensitivity(waveform, conditioning)
    raw = raw_phase_curve(waveform, conditioning)[: -1 : (len(grid_phases()) - 1) // 256]
    step = 1e-2
    for place in range(waveform.coefficients.size):
        moved = waveform.coefficients.copy()
        moved.flat[place] += step
        curve = raw_phase_curve(Waveform(ORDERS, moved), conditioning)
        cycles = np.append(grid_phases()[:-1] - 1.0, grid_phases())
        phase = np.interp(raw, np.append(curve[:-1] - 1.0, curve), cycles)
        change = (phase - np.arange(256) / 256 + 0.5) % 1.0 - 0.5
        np.testing.assert_allclose((change - change.mean()) / step, sensitivity[:, place], atol=2e-7)


def test_table_is_shifted_only_if_it_must():
    raw = np.arange(64) / 64
    near = raw + 0.12 * (1.0 - np.cos(2.0 * np.pi * raw))
    assert table_from_phases(near).entries[0] == 0.0
    far = raw + 0.14 * (1.0 - np.cos(2.0 * np.pi * raw))
    shifted = table_from_phases(far).entries
    assert shifted[0] == pytest.approx(-0.031, abs=1e-6)
    np.testing.assert_allclose(shifted - shifted[0], far, atol=1e-7)
    for phases in raw + 0.27 * (1.0 - np.cos(2.0 * np.pi * raw)), raw + 0.05 * np.sin(8.0 * np.pi * raw):
        assert refusal(table_from_phases, phases).reason == "monotonic"


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
@pytest.mark.parametrize(
    ("standstill", "faulty", "offset_counts", "goal"),
    [(0, 0.0, 0.1, 2e-4), (20_000, 0.0, 0.3, 5e-4), (0, 0.15, 3.0, 3e-3)],
)
def test_offset_gain_and_phase_are_found(seed, standstill, faulty, offset_counts, goal):
    """A long standstill does not weigh, faults are left out."""
    rng = np.random.default_rng(seed)
    encoder = Encoder(
        amplitude_counts=rng.uniform(600.0, 1200.0),
        sine_offset=rng.uniform(-0.5, 0.5), cosine_offset=rng.uniform(-0.5, 0.5),
        sine_amplitude=rng.uniform(0.7, 1.3), cosine_amplitude=rng.uniform(0.7, 1.3),
        phase_error_rad=rng.uniform(-0.6, 0.6), noise_lsb=0.5,
    )  # fmt: skip
    position = np.append(np.full(standstill, 0.17), rng.random(5000))
    sine, cosine = encoder.sample(position, rng)
    at = rng.random(len(sine)) < faulty
    sine[at] = rng.integers(-2048, 2048, at.sum())
    cosine[at & (rng.random(len(sine)) < 0.5)] = 0
    offset, ratio, phase = _error(fit_ellipse(sine, cosine), encoder)
    # Half a count of noise in 5000 samples.
    assert 1e-5 < offset < offset_counts
    assert max(ratio, phase) < goal


def test_too_few_samples_and_wrong_shapes():
    assert refusal(fit_ellipse, np.arange(10), np.arange(10)).reason == "samples"
    with pytest.raises(ValueError, match="one length"):
        fit_ellipse(np.arange(10), np.arange(11))
