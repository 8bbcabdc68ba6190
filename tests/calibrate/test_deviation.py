"""How good a table is on samples that it has not seen: right tables, wrong ones, and samples with faults."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from canfb.calibrate.measurement import Measurement, block_of
from canfb.calibration.deviation import best_deviation
from canfb.errors import CalibrationError
from canfb.master.samples import TrackSamples
from canfb.signal.correction import Correction, CorrectionTable
from commissioning_kit import random_encoder, recorded


def found(measured: Measurement, samples: TrackSamples) -> float:
    return best_deviation(
        samples.recording(12), measured.found, measured.before, block_of(measured.calibration)
    ).rms


@pytest.mark.parametrize("rpm", [31.0, 250.0, 600.0, 1900.0, -700.0])
def test_it_is_the_noise_with_the_right_table(rpm: float, measured: Measurement) -> None:
    samples = recorded(random_encoder(3), 2000, rpm=rpm, start_s=60.0, seed=2)
    assert found(measured, samples) == pytest.approx(measured.calibration.residual_rms, rel=0.25)


@pytest.mark.parametrize("size", [0.0005, 0.002])
@pytest.mark.parametrize("order", [1, 2, 5])
def test_a_wrong_table_shows_by_its_error(
    size: float, order: int, measured: Measurement, fresh: TrackSamples
) -> None:
    x = np.arange(256) / 256
    wrong = CorrectionTable(measured.calibration.table(x) + size * np.sin(2 * np.pi * order * x))
    used = Correction(wrong, measured.found.conditioning)
    got = best_deviation(fresh.recording(12), used, measured.before, block_of(measured.calibration))
    want = np.hypot(size / np.sqrt(2), measured.calibration.residual_rms)
    assert got.rms == pytest.approx(want, rel=0.25)
    assert got.peak > got.rms


def faulty(samples: TrackSamples) -> TrackSamples:
    sine = samples.sine.copy()
    sine[[100, 700, 701, 1200]] = [900.0, -900.0, 0.0, 1500.0]
    return replace(samples, sine=sine)


def with_gaps(samples: TrackSamples) -> TrackSamples:
    sine = samples.sine.copy()
    sine[200:230] = sine[900:903] = np.nan
    return replace(samples, sine=sine)


def without_trace(samples: TrackSamples) -> TrackSamples:
    """A SYNC and its PDO that this computer has not heard."""
    sine, cosine = (np.delete(track, [300, 1100]) for track in (samples.sine, samples.cosine))
    return TrackSamples.of(sine, cosine, samples.rate_hz, "with lost frames")


@pytest.mark.parametrize("bad", [faulty, with_gaps, without_trace])
def test_a_few_bad_samples_do_not_count(
    bad: Callable[[TrackSamples], TrackSamples], measured: Measurement, fresh: TrackSamples
) -> None:
    assert found(measured, bad(fresh)) == pytest.approx(found(measured, fresh), rel=0.15)


@pytest.mark.parametrize("speed", [0.0, 1.0, 0.5, 0.25])
def test_nothing_is_said_of_a_machine_that_stands_or_is_locked(speed: float, measured: Measurement) -> None:
    position = 0.3 + speed * np.arange(1500)
    sine, cosine = random_encoder(3).sample(position, np.random.default_rng(1))
    with pytest.raises(CalibrationError, match="at standstill, or its motion is locked"):
        found(measured, TrackSamples.of(sine, cosine, None, "locked"))


def test_slow_motion_is_not_taken_for_errors_nor_errors_for_motion(measured: Measurement) -> None:
    """At 150 samples a cycle a short block would follow the errors of the encoder."""
    samples = recorded(random_encoder(3), 6000, rpm=0.16, seed=4)
    right = best_deviation(samples.recording(12), measured.found, measured.before, 16)
    assert right.rms == pytest.approx(measured.calibration.residual_rms, rel=0.3)
    assert right.before_rms > 0.5 * measured.on_samples.before_rms
