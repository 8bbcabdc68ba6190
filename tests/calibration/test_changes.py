"""Tracks that change during a measurement: refused, or the stated error of the table covers them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import canfb
from canfb.calibration.over_speeds import TracksAtSpeed, calibrate_over_speeds
from canfb.calibration.result import Reason
from canfb.signal.phase import FloatArray

Changed = Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
NOISE_COUNTS, AMPLITUDE_COUNTS = 0.5, 1500.0


def tracks(position: FloatArray, seed: int) -> tuple[FloatArray, FloatArray]:
    """Counts of an encoder with offsets, phase error and a third harmonic."""
    rng, angle = np.random.default_rng(seed), 2.0 * np.pi * position
    sine = np.sin(angle) + 0.01 * np.sin(3.0 * angle) + 0.02
    cosine = 1.04 * np.cos(angle + 0.04) + 0.01 * np.cos(3.0 * angle) - 0.01
    noise = rng.normal(0.0, NOISE_COUNTS, (2, len(position)))
    return AMPLITUDE_COUNTS * sine + noise[0], AMPLITUDE_COUNTS * cosine + noise[1]


def any_motion(n: int) -> FloatArray:
    k = np.arange(float(n))
    return np.cumsum(np.minimum(k * 0.002, 1.37) * (1.0 + 0.01 * np.sin(k / 230.0)))


def slow_motion(n: int) -> FloatArray:
    return 0.0173 * np.arange(float(n))


METHODS = {
    canfb.calibrate_from_motion: (any_motion, 9000),
    canfb.calibrate_from_zero_crossings: (slow_motion, 9000),
}
CHANGES: dict[str, Changed] = {
    "drift of 2 counts": lambda s, c, u: (s + 2.0 * u, c),
    "drift of 2 %": lambda s, c, u: (s + 30.0 * u, c),
    "gain drifts by 3 %": lambda s, c, u: (s * (1.0 + 0.03 * u), c),
    "jump at half time": lambda s, c, u: (s, c + 100.0 * (u > 0.5)),
    "jump near the end": lambda s, c, u: (s, c + 20.0 * (u > 0.9)),
    "exchanged": lambda s, c, u: (np.where(u > 0.5, c, s), np.where(u > 0.5, s, c)),
    "inverted": lambda s, c, u: (np.where(u > 0.4, -s, s), c),
}


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.__name__)
@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_no_accuracy_is_stated_that_the_end_of_the_measurement_contradicts(
    method: Callable[..., canfb.Calibration], change: Changed
) -> None:
    motion, n = METHODS[method]
    sine, cosine = change(*tracks(motion(n), 1), np.arange(n) / n)
    found, reason = None, ""
    try:
        found = method(np.round(sine), np.round(cosine), "fit")
    except canfb.CalibrationError as error:
        reason = error.reason
    if found is None:
        assert reason == Reason.CHANGED
        return
    position = np.arange(4096) / 4096
    later = change(*tracks(position, 7), np.ones(4096))
    raw = canfb.phase_in_cycle(*found.conditioning.apply(*later))
    off = (found.table(raw) - position + 0.25) % 1.0
    noise = 6.0 * NOISE_COUNTS / AMPLITUDE_COUNTS / (2.0 * np.pi)
    assert np.abs(off - np.median(off)).max() < found.uncertainty_peak + noise


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.__name__)
@pytest.mark.parametrize("seed", range(3))
def test_steady_tracks_do_not_change(method: Callable[..., canfb.Calibration], seed: int) -> None:
    motion, n = METHODS[method]
    found = method(*tracks(motion(n), seed), "fit")
    assert found.change_rms == 0.0
    assert found.uncertainty_peak < 2e-4


def test_the_larger_figure_is_stated_for_a_small_drift() -> None:
    n = 9000
    sine, cosine = tracks(any_motion(n), 1)
    found = canfb.calibrate_from_motion(sine + 5.0 * np.arange(n) / n, cosine, "fit")
    # 5 counts turn the phase by 5 / 1500 rad at the most; the first and last of nine parts see 8/9 of it.
    assert found.change_rms == pytest.approx(8 / 9 * 5 / 1500 / 2 / np.pi / np.sqrt(2), rel=0.15)
    assert found.uncertainty_rms == found.change_rms
    assert found.cramer_rao_ratio is not None
    assert found.cramer_rao_ratio > 10.0


def test_tracks_that_change_from_one_speed_to_the_next_are_refused() -> None:
    measured = []
    for number, per_sample in enumerate((0.0317, 0.2371, 0.4123)):
        sine, cosine = tracks(per_sample * np.arange(6000.0), number)
        measured.append(TracksAtSpeed(sine + 70.0 * (number == 2), cosine, 1000.0, 1000.0 * per_sample))
    with pytest.raises(canfb.CalibrationError, match="tables of the speeds differ") as caught:
        calibrate_over_speeds(measured)
    assert caught.value.reason == Reason.CHANGED
