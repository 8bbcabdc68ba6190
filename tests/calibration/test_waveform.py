from __future__ import annotations

import numpy as np
import pytest
from measurements import random_encoder, true_phases

from canfb.calibration.joint import (
    Waveform,
    basis,
    grid_phases,
    raw_phase_curve,
    table_from_phases,
    table_of,
    table_sensitivity,
)
from canfb.errors import CalibrationError
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.simulation.encoder import Encoder

ORDERS = (1, 2, 3, 5)


def _waveform(encoder: Encoder) -> Waveform:
    """The encoder's tracks as a Fourier series, by least squares over one cycle."""
    position = np.arange(512) / 512
    tracks = np.column_stack(encoder.tracks(position))
    solution = np.linalg.lstsq(basis(position, ORDERS), tracks, rcond=None)[0].astype(np.float64)
    return Waveform(ORDERS, solution[:, 0], solution[:, 1])


@pytest.mark.parametrize("seed", range(4))
def test_tracks_and_slope_are_the_encoders(seed):
    rng = np.random.default_rng(seed)
    encoder = random_encoder(rng, 0.0)
    waveform, position = _waveform(encoder), rng.random(100)
    step = 1e-5
    for track, slope, ahead, behind in zip(
        waveform.tracks(position),
        waveform.slope().tracks(position),
        encoder.tracks(position + step),
        encoder.tracks(position - step),
        strict=True,
    ):
        np.testing.assert_allclose(track, (ahead + behind) / 2.0, atol=1e-3)
        np.testing.assert_allclose(slope, (ahead - behind) / (2.0 * step), rtol=1e-4, atol=0.1)


@pytest.mark.parametrize("conditioning", [IDENTITY, Conditioning(20.0, -10.0, 1.1, 0.9, 0.1)])
@pytest.mark.parametrize("seed", range(3))
def test_table_is_the_inverse_of_the_raw_phase(seed, conditioning):
    encoder = random_encoder(np.random.default_rng(seed), 0.0)
    table = table_of(raw_phase_curve(_waveform(encoder), conditioning), 256)
    assert table.entries[0] == 0.0
    true = true_phases(encoder, 256, conditioning)
    # REAL32 has steps of 6e-8 below 1.
    np.testing.assert_allclose(table.entries, true - true[0], atol=1e-7)


def test_sensitivity_is_the_change_of_the_table():
    waveform = _waveform(random_encoder(np.random.default_rng(6), 0.0))
    conditioning = Conditioning(15.0, 5.0, 0.95, 1.05, -0.08)
    sensitivity = table_sensitivity(waveform, conditioning)
    raw = raw_phase_curve(waveform, conditioning)[: -1 : (len(grid_phases()) - 1) // 256]
    half, step = len(waveform.sine), 1e-2
    for place in range(2 * half):
        moved = np.concatenate([waveform.sine, waveform.cosine])
        moved[place] += step
        other = Waveform(ORDERS, moved[:half], moved[half:])
        curve = raw_phase_curve(other, conditioning)
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
    with pytest.raises(CalibrationError) as refused:
        table_from_phases(raw + 0.27 * (1.0 - np.cos(2.0 * np.pi * raw)))
    assert refused.value.reason == "monotonic"
    with pytest.raises(CalibrationError) as refused:
        table_from_phases(raw + 0.05 * np.sin(8.0 * np.pi * raw))
    assert refused.value.reason == "monotonic"
