"""What a calibration says of itself is true: uncertainty, noise, bound, residuals, harmonics."""

from __future__ import annotations

import numpy as np
import pytest
from measurements import random_encoder, table_error, wandering

from canfb.calibration.from_motion import calibrate_from_motion
from canfb.calibration.result import Calibration
from canfb.signal.phase import raw_phases
from canfb.simulation.encoder import Encoder, Harmonic


@pytest.fixture(scope="module")
def several() -> list[tuple[Encoder, Calibration]]:
    """Encoders, speeds and noise at random."""
    found = []
    for seed in range(12):
        rng = np.random.default_rng(100 + seed)
        encoder = random_encoder(rng, rng.uniform(0.4, 2.0))
        position = wandering(10.0 ** rng.uniform(1.0, 3.5), rng, 5.0)
        found.append((encoder, calibrate_from_motion(*encoder.sample(position, rng))))
    return found


def test_error_is_within_the_cramer_rao_bound_times_1_3(several):
    squares = [
        np.mean(table_error(result.table, encoder) ** 2) / result.bound_rms**2 for encoder, result in several
    ]
    # Some 8 degrees of freedom each, 12 times: the mean scatters by 15 %, its root by 7 %.
    assert 0.75 < np.sqrt(np.mean(squares)) < 1.3
    assert np.sqrt(np.max(squares)) < 2.5


def test_ratio_to_the_bound_is_measured_from_the_data_alone(several):
    ratios = [result.cramer_rao_ratio for _, result in several]
    assert 0.8 < np.sqrt(np.mean(np.square(ratios))) < 1.3
    assert max(ratios) < 1.8


def test_uncertainty_is_what_the_error_is(several):
    errors = [table_error(result.table, encoder) for encoder, result in several]
    pairs = list(zip(errors, (result for _, result in several), strict=True))
    rms = [np.std(error) / result.uncertainty_rms for error, result in pairs]
    peak = [np.abs(error).max() / result.uncertainty_peak for error, result in pairs]
    assert 0.6 < np.sqrt(np.mean(np.square(rms))) < 1.2
    assert 0.15 < np.median(peak) < 0.7
    assert max(peak) < 1.1


def test_residuals_are_those_of_fresh_data(several):
    for encoder, result in several:
        rng = np.random.default_rng(1)
        position = wandering(333.0, rng, 2.0)
        raw = raw_phases(*(track.astype(float) for track in encoder.sample(position, rng)))
        for phase, rms in ((raw, result.before_rms), (result.table(raw), result.residual_rms)):
            off = (phase - position) % 1.0
            off = (off - np.angle(np.mean(np.exp(2j * np.pi * off))) / (2.0 * np.pi) + 0.5) % 1.0 - 0.5
            assert off.std() == pytest.approx(rms, rel=0.2)
        assert 3.0 * result.residual_rms < result.residual_peak < 7.0 * result.residual_rms
        assert result.before_rms < result.before_peak < 4.0 * result.before_rms


def test_noise_is_found(several):
    for encoder, result in several:
        assert result.noise_counts == pytest.approx(np.hypot(encoder.noise_lsb, 12.0**-0.5), rel=0.08)
        assert result.noise_cycles == pytest.approx(
            result.noise_counts / (2.0 * np.pi * encoder.amplitude_counts), rel=0.2
        )


def test_curve_shows_the_error_before_and_none_after(several):
    for encoder, result in several:
        curve = result.curve
        assert len(curve.phase) == len(curve.before) == len(curve.after) == 64
        bins = 2.0 * result.residual_rms / np.sqrt(result.samples_used / 64.0)
        assert np.sqrt(np.mean(curve.after**2)) < 1.5 * bins
        # Where the phase steps by a simple fraction, the blocks take part of the error for motion.
        assert 0.5 * result.before_rms < np.std(curve.before) < 1.1 * result.before_rms
        # Raw phase is what the table corrects: before is the negative of what the table adds.
        added = result.table.entries - np.arange(len(result.table)) / len(result.table)
        seen = np.interp(curve.phase, result.table.entries, added - added.mean(), period=1.0)
        assert np.corrcoef(seen, -curve.before)[0, 1] > 0.98
        assert encoder.adc_bits == 12


def test_only_orders_that_are_there_are_kept(several):
    extra = [len(set(result.track_orders) - {1, 2, 3, 5}) for _, result in several]
    assert all(result.track_orders[0] == 1 for _, result in several)
    # One in 300 of the others passes by chance.
    assert sum(extra) <= 3


def test_harmonics_are_those_of_the_encoder():
    rng = np.random.default_rng(2)
    encoder = Encoder(harmonics=(Harmonic(3, 0.03, 0.03),), noise_lsb=0.5)
    result = calibrate_from_motion(*encoder.sample(wandering(500.0, rng, 5.0), rng))
    # sin + e sin 3x and cos + e cos 3x: the angle is ahead by e sin 2x.
    first = result.harmonics[0]
    assert first.order == 2
    assert first.amplitude_cycles == pytest.approx(0.03 / (2.0 * np.pi), rel=0.02)
    assert first.angle_rad == pytest.approx(-np.pi / 2.0, abs=0.02)
    assert all(h.amplitude_cycles < 0.05 * first.amplitude_cycles for h in result.harmonics[1:])
    assert result.track_orders == (1, 3)
