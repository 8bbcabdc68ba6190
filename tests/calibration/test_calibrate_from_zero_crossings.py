from __future__ import annotations

import numpy as np
import pytest
from measurements import PERCENT, extreme_encoder, paper_motion, random_encoder, table_error

from canfb.calibration.from_motion import calibrate_from_motion
from canfb.calibration.zero_crossing import calibrate_from_zero_crossings
from canfb.errors import CalibrationError
from canfb.simulation.encoder import Encoder


def _ideal(rng: np.random.Generator, noise_lsb: float) -> Encoder:
    return Encoder(amplitude_counts=rng.uniform(1200.0, 1900.0), noise_lsb=noise_lsb)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("kind", "goal"),
    [(_ideal, 0.02 * PERCENT), (random_encoder, 0.02 * PERCENT), (extreme_encoder, 0.05 * PERCENT)],
)
def test_table_is_better_than_the_papers(kind, goal, seed):
    rng = np.random.default_rng(seed)
    encoder = kind(rng, 0.5)
    result = calibrate_from_zero_crossings(*encoder.sample(paper_motion(rng, 1.0), rng))
    error = table_error(result.table, encoder)
    assert 0.002 * PERCENT / 10.0 < np.abs(error).max() < goal / 4.0
    assert np.abs(error).max() < 1.5 * result.uncertainty_peak
    assert result.accepted
    assert result.coverage == 1.0
    assert 500 < result.cycles_used < 700
    # Noise of half a count and its rounding, and the same again from the crossings.
    assert 0.4e-4 < result.residual_rms < 2.5e-4
    assert result.before_rms > 20.0 * result.residual_rms


def test_few_cycles_are_enough_and_fewer_are_refused():
    rng = np.random.default_rng(5)
    encoder = random_encoder(rng, 0.5)
    sine, cosine = encoder.sample(paper_motion(rng, 1.0), rng)
    few = calibrate_from_zero_crossings(sine[:3000], cosine[:3000])
    assert 16 <= few.cycles_used < 60
    assert np.abs(table_error(few.table, encoder)).max() < 0.02 * PERCENT
    with pytest.raises(CalibrationError) as refused:
        calibrate_from_zero_crossings(sine[:800], cosine[:800])
    assert refused.value.reason == "cycles"


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_reversal_in_the_middle_is_left_out(sign):
    rng = np.random.default_rng(7)
    encoder = random_encoder(rng, 0.5)
    way = sign * paper_motion(rng, 0.5)
    there_and_back = np.concatenate([way, way[:-1][::-1][: len(way) // 3]])
    result = calibrate_from_zero_crossings(*encoder.sample(there_and_back, rng))
    assert np.abs(table_error(result.table, encoder)).max() < 0.005 * PERCENT


def test_faulty_samples_are_left_out():
    rng = np.random.default_rng(8)
    encoder = random_encoder(rng, 0.5)
    sine, cosine = encoder.sample(paper_motion(rng, 0.5), rng)
    valid = np.ones(len(sine), np.bool_)
    at = rng.choice(len(sine), 60, replace=False)
    sine[at[:30]] = -sine[at[:30]]
    valid[at[:30]] = False
    cosine[at[30:]] = rng.integers(-2000, 2000, 30)  # faults that nobody marked
    result = calibrate_from_zero_crossings(sine, cosine, valid=valid)
    assert np.abs(table_error(result.table, encoder)).max() < 0.005 * PERCENT


def test_too_fast_is_refused():
    rng = np.random.default_rng(9)
    encoder = random_encoder(rng, 0.5)
    for every in (4, 50):
        position = paper_motion(rng, 1.0)[::every]
        with pytest.raises(CalibrationError) as refused:
            calibrate_from_zero_crossings(*encoder.sample(position, rng))
        assert refused.value.reason == "speed"


@pytest.mark.parametrize("conditioning", [None, "fit"])
def test_both_methods_give_one_table(conditioning):
    rng = np.random.default_rng(10)
    encoder = random_encoder(rng, 0.5)
    sine, cosine = encoder.sample(paper_motion(rng, 1.0), rng)
    slow = calibrate_from_zero_crossings(sine, cosine, conditioning)
    # The same encoder at 1 kHz: every 50th sample, and 8 s of them.
    far = paper_motion(rng, 8.0)[::50]
    fast = calibrate_from_motion(*encoder.sample(far, rng), slow.conditioning)
    difference = slow.table.entries - fast.table.entries
    # Not aligned: both must mean the same by phase 0.
    assert 1e-7 < np.abs(difference).max() < 0.01 * PERCENT
    assert slow.conditioning.is_identity == (conditioning is None)


@pytest.mark.parametrize(
    "wrong", [{"entries": 8}, {"conditioning": "ellipse"}, {"valid": [True]}, {"time_s": [0.0]}]
)
def test_wrong_arguments_raise(wrong):
    sine, cosine = Encoder().sample(np.arange(2000) / 50.0)
    for method in (calibrate_from_zero_crossings, calibrate_from_motion):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            method(sine, cosine, **wrong)
