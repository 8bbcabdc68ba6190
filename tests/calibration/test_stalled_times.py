"""Recordings of a machine whose sampling stalls: any window of them, whatever it begins with."""

from __future__ import annotations

import numpy as np
import pytest
from measurements import table_error

from canfb.calibration.deviation import best_deviation
from canfb.calibration.from_motion import calibrate_from_motion
from canfb.calibration.recording import positions, recording
from canfb.signal.correction import NO_CORRECTION
from canfb.signal.phase import FloatArray, raw_phases
from canfb.simulation.encoder import Encoder

# 4 % offset and 3 % gain error: 0.02 cycle of phase error without a table.
POOR = Encoder(
    amplitude_counts=1400.0, sine_offset=0.04, cosine_offset=-0.03, sine_amplitude=1.03, noise_lsb=0.5
)
# Intervals from the sample before a stall of 20 ms at 100 Hz on.
MEASURED_STALL_S = (0.03075, 0.00096, 0.00839)
TICK_S = 1e-7
SPEEDS = (0.0, 0.37, 0.5, 3.3, 25.6, -41.7, 83.3, 125.0, -250.6)


def stalled(n: int, rate_hz: float, rng: np.random.Generator, every: int, jitter: float) -> FloatArray:
    """Sample times in seconds, in ticks of 100 ns: even but for ``jitter`` (part of an interval), with a
    stall after about ``every`` samples, as it was measured at 100 Hz and of other lengths."""
    steps: list[float] = []
    while len(steps) < n:
        steps += [1.0] * (1 + int(rng.exponential(every)))
        if rate_hz == 100.0 and rng.random() < 0.5:
            steps += [rate_hz * one for one in MEASURED_STALL_S]
        else:
            gap, short = rng.uniform(1.1, 9.0), rng.uniform(0.05, 0.3)
            steps += [gap, short, np.ceil(gap + short + 0.05) - gap - short]  # back on the grid
    time = np.cumsum(steps[:n]) + rng.uniform(-jitter, jitter, n)
    return np.round(time / rate_hz / TICK_S) * TICK_S


def turning(time_s: FloatArray, rate_hz: float, speed: float, acceleration: float = 0.002) -> FloatArray:
    """Positions in cycles: ``speed`` in cycles per interval, which swings with at most this acceleration."""
    turn = 2.0 * np.pi * 0.4 / rate_hz
    time = time_s * rate_hz
    return speed * time + acceleration / turn**2 * np.sin(turn * time + 1.0)


def phases(position: FloatArray, rng: np.random.Generator) -> FloatArray:
    sine, cosine = POOR.sample(position, rng)
    return raw_phases(sine.astype(np.float64), cosine.astype(np.float64))


@pytest.mark.parametrize("speed", SPEEDS)
@pytest.mark.parametrize("rate_hz", [100.0, 500.0, 1000.0])
def test_every_window_is_followed_with_the_right_speed(rate_hz: float, speed: float) -> None:
    """Right but for a straight line, which is all that a calibration needs: no cycle is missing anywhere."""
    rng = np.random.default_rng([int(rate_hz), int(10 * abs(speed))])
    for every, jitter in ((20, 1e-4), (60, 1e-6), (200, 1e-3)):
        time_s = stalled(3000, rate_hz, rng, every, jitter)
        true = turning(time_s, rate_hz, speed)
        phase = phases(true, rng)
        time = time_s * rate_hz
        for length in (300, 1520):
            for start in range(0, 3000 - length + 1, 193 if length == 300 else 307):
                window = slice(start, start + length)
                off = positions(phase[window], time[window], True, np.zeros(0, np.int64)) - true[window]
                line = np.polynomial.Polynomial.fit(time[window], off, 1)
                # Of a few stalls that are alike, another speed may fit the phases to a fifth of a cycle.
                assert np.abs(off - line(time[window])).max() < 0.3, (every, jitter, length, start)


@pytest.mark.parametrize(("rate_hz", "speed"), [(100.0, 25.6), (500.0, 3.3), (1000.0, -41.7)])
def test_every_window_is_accepted_and_its_table_is_right(rate_hz: float, speed: float) -> None:
    rng = np.random.default_rng(int(rate_hz))
    time_s = stalled(4000, rate_hz, rng, 120, 1e-3)
    sine, cosine = POOR.sample(turning(time_s, rate_hz, speed), rng)
    for start, length in ((0, 1520), (311, 1520), (2480, 1520), (1234, 400), (3600, 400)):
        window = slice(start, start + length)
        tracks = sine[window], cosine[window]
        found = calibrate_from_motion(*tracks, "fit", time_s=time_s[window])
        error = table_error(found.table, POOR, found.conditioning)
        assert np.sqrt(np.mean(error**2)) < 3.0 * found.uncertainty_rms + 1e-5
        # As canfb calibrate verifies a table: on samples that it does not know, against the prediction.
        fresh = slice(max(0, start - 800), max(0, start - 800) + 800)
        record = recording(sine[fresh], cosine[fresh], time_s[fresh], None, None)
        seen = best_deviation(record, found.correction, NO_CORRECTION, found.block_samples)
        assert seen.rms < 1.5 * found.residual_rms + found.uncertainty_rms


def test_a_long_interval_at_full_acceleration_loses_no_cycle() -> None:
    """The speed before the gap alone is 0.02 * 8 * 9 / 2 = 0.72 cycle off."""
    time = np.concatenate([np.arange(200.0), 207.0 + np.arange(200.0)])
    time += np.random.default_rng(3).uniform(-0.02, 0.02, 400)  # else one gap alone would decide the speed
    true = 12.3 * time + 0.01 * time**2
    off = positions(true % 1.0, time, True, np.zeros(0, np.int64)) - true
    assert np.abs(off - off[0]).max() < 1e-6


def test_samples_in_a_flood_after_a_stall_do_not_multiply_their_errors() -> None:
    rng = np.random.default_rng(8)
    steps = ([1.0] * 40 + [6.3] + [0.07] * 10 + [1.0]) * 20
    time = np.cumsum(steps)
    true = -33.4 * time
    phase = phases(true, rng)
    off = positions(phase, time, True, np.zeros(0, np.int64)) - true
    assert np.ptp(off) < 0.06


@pytest.mark.parametrize("n", [0, 1, 2, 3, 5])
def test_a_few_samples_are_followed_too(n: int) -> None:
    time = np.array([0.0, 0.1, 0.9, 2.0, 3.1])[:n]
    phase = (0.2 * time + 0.9) % 1.0
    found = positions(phase, time, True, np.zeros(0, np.int64))
    np.testing.assert_allclose(np.diff(found), 0.2 * np.diff(time), atol=1e-9 if n > 2 else 1.0)
    assert np.isfinite(positions(np.full(n, np.nan), time, True, np.zeros(0, np.int64))).all()
