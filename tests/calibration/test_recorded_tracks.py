"""Samples as object 2050h gives them: missing ones are left out, and no time is lost."""

from __future__ import annotations

import numpy as np
import pytest
from measurements import random_encoder, table_error, wandering

from canfb.calibration.from_motion import calibrate_from_motion
from canfb.calibration.recording import recorded_tracks, recording
from canfb.signal.sample_recording import SampleRecording


def recorded(sine, cosine, missing) -> SampleRecording:
    made = SampleRecording()
    for s, c, missed in zip(sine.tolist(), cosine.tolist(), missing.tolist(), strict=True):
        made.miss() if missed else made.take(s, c)
    return made


def test_what_was_recorded_comes_back() -> None:
    made = SampleRecording()
    made.take(1, -32768)
    made.miss()
    made.take(-32768, 32767)
    sine, cosine = recorded_tracks(made.to_bytes())
    np.testing.assert_array_equal(sine, [1.0, np.nan, -32768.0])
    np.testing.assert_array_equal(cosine, [-32768.0, np.nan, 32767.0])
    assert [len(track) for track in recorded_tracks(b"")] == [0, 0]


@pytest.mark.parametrize("length", [1, 2, 3, 7])
def test_a_recording_that_was_cut_off_is_a_wrong_argument(length: int) -> None:
    with pytest.raises(ValueError, match="4 bytes per sample"):
        recorded_tracks(bytes(length))


def test_missing_samples_are_left_out_and_the_time_goes_on() -> None:
    rng = np.random.default_rng(1)
    encoder = random_encoder(rng, 0.5)
    sine, cosine = encoder.sample(wandering(700.0, rng, 6.0), rng)
    missing = rng.random(len(sine)) < 0.05
    data = recorded(sine, cosine, missing).to_bytes()
    result = calibrate_from_motion(*recorded_tracks(data))
    assert np.abs(table_error(result.table, encoder)).max() < 2e-4
    as_integers = np.frombuffer(data, "<i2").reshape(-1, 2)
    again = calibrate_from_motion(as_integers[:, 0], as_integers[:, 1])
    assert again.table == result.table
    assert again.samples_used == result.samples_used <= (~missing).sum()


def test_the_mark_is_neither_valid_nor_clipped() -> None:
    sine, cosine = np.full(1000, 100), np.full(1000, -100)
    sine[::10] = cosine[::10] = -32768
    record = recording(sine, cosine, None, None, None)
    assert record.valid.sum() == 900
    assert not record.clipped.any()
    assert record.sine.min() == 0.0
