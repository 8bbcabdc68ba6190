"""From samples to positions: what was recorded, its motion however its times are, and the blocks of it."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from measurements import table_error

from canfb.calibration.deviation import best_deviation
from canfb.calibration.methods import calibrate_from_motion
from canfb.calibration.recording import BASELINE, LONGEST_LAG, positions, recorded_tracks, recording
from canfb.calibration.result import Reason
from canfb.signal import sample_recording
from canfb.signal.correction import NO_CORRECTION
from canfb.signal.phase import FloatArray, raw_phases
from canfb.signal.sample_recording import BYTES_PER_SAMPLE, SampleRecording
from canfb.simulation.encoder import Encoder

COUNTS = st.integers(-0x8000, 0x7FFF)


@given(st.lists(st.one_of(st.none(), st.tuples(COUNTS, COUNTS)), max_size=40), st.integers(1, 50))
def test_what_was_recorded_comes_back(samples: list[tuple[int, int] | None], capacity: int) -> None:
    made = SampleRecording(capacity)
    for one in samples:
        made.miss() if one is None else made.take(*one)
    kept = [one or (np.nan, np.nan) for one in samples][:capacity]
    kept = [(np.nan, np.nan) if one == (-0x8000, -0x8000) else one for one in kept]
    np.testing.assert_array_equal(recorded_tracks(made.to_bytes()), np.reshape(kept, (-1, 2)).T)
    assert len(made) == len(kept) == len(made.to_bytes()) // BYTES_PER_SAMPLE
    assert made.is_full == (len(kept) == capacity)
    made.clear()
    assert (len(made), made.to_bytes(), made.is_full) == (0, b"", False)


def test_the_bytes_of_a_recording(monkeypatch: pytest.MonkeyPatch) -> None:
    made = SampleRecording()
    made.take(0x0102, 0x0304)
    made.miss()
    assert made.to_bytes() == b"\x02\x01\x04\x03\x00\x80\x00\x80"
    monkeypatch.setattr(sample_recording.sys, "byteorder", "big")
    assert made.to_bytes() == b"\x01\x02\x03\x04\x80\x00\x80\x00"
    for cut_off in (1, 2, 3, 7):
        with pytest.raises(ValueError, match="4 bytes per sample"):
            recorded_tracks(bytes(cut_off))
    for capacity in (0, -1):
        with pytest.raises(ValueError, match="1 or more"):
            SampleRecording(capacity)


def test_the_mark_is_neither_valid_nor_clipped() -> None:
    sine, cosine = np.full(1000, 100), np.full(1000, -100)
    sine[::10] = cosine[::10] = -32768
    record = recording(sine, cosine, None, None, None)
    assert record.valid.sum() == 900
    assert not record.clipped.any()
    assert record.sine.min() == 0.0


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


# 4 % offset and 3 % gain error: 0.02 cycle of phase error without a table.
POOR = Encoder(
    amplitude_counts=1400.0, sine_offset=0.04, cosine_offset=-0.03, sine_amplitude=1.03, noise_lsb=0.5
)
# Intervals from the sample before a stall of 20 ms at 100 Hz on.
MEASURED_STALL_S = (0.03075, 0.00096, 0.00839)
TICK_S = 1e-7


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


@pytest.mark.parametrize("speed", [0.0, 0.37, 0.5, 3.3, 25.6, -41.7, 83.3, 125.0, -250.6])
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
                off = positions(phase[window], time[window], True, NO_BREAKS) - true[window]
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
    off = positions(true % 1.0, time, True, NO_BREAKS) - true
    assert np.abs(off - off[0]).max() < 1e-6


def test_samples_in_a_flood_after_a_stall_do_not_multiply_their_errors() -> None:
    time = np.cumsum(([1.0] * 40 + [6.3] + [0.07] * 10 + [1.0]) * 20)
    true = -33.4 * time
    phase = phases(true, np.random.default_rng(8))
    assert np.ptp(positions(phase, time, True, NO_BREAKS) - true) < 0.06


@given(steps=st.lists(st.floats(0.01, 1.4), min_size=3, max_size=90), speed=st.floats(-30.0, 30.0))
def test_the_motion_that_is_left_is_followed_with_bits_of_arrays(steps: list[float], speed: float) -> None:
    time = np.cumsum(steps)
    phase = speed * time % 1.0
    found = positions(phase, time, True, NO_BREAKS)
    k = np.arange(np.searchsorted(time, time[0] + BASELINE) + 1, len(time))
    base = np.maximum(np.searchsorted(time, time[k - 1] - BASELINE, side="right") - 1, k - 1 - LONGEST_LAG)
    ahead = found[k - 1] + (found[k - 1] - found[base]) * (np.diff(time)[k - 1] / (time[k - 1] - time[base]))
    assert (found[k] == np.rint(ahead - phase[k]) + phase[k]).all()


@pytest.mark.parametrize("n", [0, 1, 2, 3, 5])
def test_a_few_samples_are_followed_too(n: int) -> None:
    time = np.array([0.0, 0.1, 0.9, 2.0, 3.1])[:n]
    phase = (0.2 * time + 0.9) % 1.0
    found = positions(phase, time, True, NO_BREAKS)
    np.testing.assert_allclose(np.diff(found), 0.2 * np.diff(time), atol=1e-9 if n > 2 else 1.0)
    assert np.isfinite(positions(np.full(n, np.nan), time, True, NO_BREAKS)).all()


def test_reasons_keep_their_numbers():
    # Object 2030:07 holds the number.
    names = "accepted samples clipped ellipse coverage cycles locked noise monotonic speed interrupted failed"
    assert " ".join(Reason) == f"{names} changed"
    assert [Reason.of_number(n) for n in range(len(Reason))] == list(Reason)
    assert [reason.number for reason in Reason] == list(range(len(Reason)))
    assert Reason.of_number(len(Reason)) is Reason.FAILED
