from __future__ import annotations

import numpy as np
import pytest

from canfb.calibration.recording import positions

NO_BREAKS = np.zeros(0, np.int64)
N = 3000


def _motion(speed: float, acceleration: float, time: np.ndarray) -> np.ndarray:
    return 0.3 + speed * time + 30.0 * np.sin(time / 400.0) + acceleration * time**2 / 2.0


@pytest.mark.parametrize("speed", [0.0, 0.4, 0.5, 1.0, 2.7, -17.2, 83.3, 125.0, -250.6])
@pytest.mark.parametrize("jitter", [1e-3, 0.02, 0.2])
def test_any_starting_speed_is_found_with_uneven_times(speed, jitter):
    rng = np.random.default_rng([int(10 * abs(speed)), int(1e3 * jitter)])
    time = np.arange(float(N)) + rng.uniform(-jitter, jitter, N)
    true = _motion(speed, 1e-4, time)
    # Harmonics of a poor encoder, not yet corrected; small ones where the times tell little.
    harmonic = 0.01 if jitter > 0.01 else 0.001
    phase = (true + harmonic * np.sin(4.0 * np.pi * true) + rng.normal(0.0, 1e-4, N)) % 1.0
    found = positions(phase, time, True, NO_BREAKS)
    off = found - true
    # Right but for a constant; the phase itself is kept.
    assert np.abs(off - np.median(off)).max() < 0.03
    np.testing.assert_allclose((found - phase + 0.5) % 1.0, 0.5, atol=1e-9)


def test_missing_samples_are_stepped_over_and_breaks_start_afresh():
    rng = np.random.default_rng(2)
    time = np.arange(float(N))
    time[1500:] += 400.0
    true = _motion(0.31, 0.0, time)
    phase = np.where(rng.random(N) < 0.05, np.nan, true % 1.0)
    for uneven in (False, True):
        found = positions(phase, time, uneven, np.array([1500]))
        for part in (slice(0, 1500), slice(1500, N)):
            seen = ~np.isnan(phase[part])
            # The first step may be an alias.
            off, when = (found - true)[part][seen][1:], time[part][seen][1:]
            line = np.polynomial.Polynomial.fit(when, off, 1)
            assert np.abs(off - line(when)).max() < 1e-6
            assert abs(found[part][seen][0]) < 1.0
