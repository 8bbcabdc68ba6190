"""A bad measurement is refused with the reason, also one whose tracks change; never returned as good."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from measurements import random_encoder, refusal, table_error, wandering

import canfb
from canfb.calibration.from_motion import calibrate_from_motion
from canfb.calibration.over_speeds import TracksAtSpeed, calibrate_over_speeds
from canfb.calibration.result import Reason
from canfb.calibration.zero_crossing import calibrate_from_zero_crossings
from canfb.errors import CalibrationError, CanfbError
from canfb.signal.phase import FloatArray
from canfb.simulation.encoder import Encoder

N = 6000


def _reason(sine, cosine, method=calibrate_from_motion, **options) -> str:
    error = refusal(method, sine, cosine, **options)
    assert isinstance(error, CanfbError)
    assert error.reason in list(Reason)
    assert len(str(error)) > 20
    if error.calibration is not None:
        assert not error.calibration.accepted
        assert error.calibration.reason == error.reason
        assert error.calibration.verdict.startswith("refused")
    return error.reason


def _tracks(position: FloatArray, seed: int = 1, noise_lsb: float = 0.5):
    rng = np.random.default_rng(seed)
    return random_encoder(rng, noise_lsb).sample(position, rng)


def test_standstill_and_short_ways():
    assert _reason(*_tracks(np.full(N, 0.3))) == "coverage"
    assert _reason(*_tracks(np.linspace(0.0, 0.6, N))) == "coverage"
    assert _reason(*_tracks(np.linspace(0.0, 6.0, N))) == "cycles"


@pytest.mark.parametrize("speed", [1.0, 83.0, 1 / 2, 1 / 3, 2 / 7, 0.125, 1.0 / 16.0])
def test_motion_locked_to_the_samples(speed):
    # A whole number of cycles per sample cannot be told from standstill.
    expected = "coverage" if speed == int(speed) else "locked"
    assert _reason(*_tracks(speed * np.arange(N) + 0.1)) == expected


@pytest.mark.parametrize("speed", [1.0, 0.5, 1 / 3])
def test_motion_that_creeps_away_from_the_lock(speed):
    assert _reason(*_tracks((speed + 2e-5) * np.arange(N))) in ("locked", "coverage", "cycles", "ellipse")


def test_clipped_tracks():
    rng = np.random.default_rng(2)
    position = wandering(300.0, rng, 6.0)
    for amplitude in (2070.0, 2600.0, 10000.0):
        assert _reason(*Encoder(amplitude_counts=amplitude, noise_lsb=0.5).sample(position, rng)) == "clipped"
    near = Encoder(amplitude_counts=2040.0, noise_lsb=0.5)
    assert np.abs(table_error(calibrate_from_motion(*near.sample(position, rng)).table, near)).max() < 3e-5
    small = Encoder(amplitude_counts=540.0, adc_bits=10, noise_lsb=0.5).sample(position, rng)
    assert _reason(*small, adc_bits=10) == "clipped"


def test_samples_beyond_the_converter_are_a_wrong_argument():
    with pytest.raises(ValueError, match="adc_bits"):
        calibrate_from_motion(*Encoder().sample(np.arange(1000) * 0.1), adc_bits=8)


def test_noise():
    rng = np.random.default_rng(3)
    position = wandering(300.0, rng, 6.0)
    assert _reason(*_tracks(position, noise_lsb=300.0)) == "noise"
    assert _reason(*_tracks(position + rng.normal(0.0, 0.06, len(position)))) == "noise"
    assert _reason(*_tracks(rng.uniform(0.0, 50.0, N))) == "noise"
    # A jitter of 20 us of the samples is 1.7 cycles at 83 cycles per sample.
    time = np.arange(N) / 1000.0 + rng.normal(0.0, 2e-5, N)
    assert _reason(*_tracks(83000.0 * (time + 0.03 * np.sin(time)))) == "noise"


def test_accelerations_that_no_tracker_follows():
    # Eq. 10 at 1 kHz allows half a cycle per sample squared; this is three times as much, to and fro.
    assert _reason(*_tracks(15.0 * np.sin(np.arange(N) * 0.317))) in ("noise", "locked")


def test_tracks_that_do_not_circle_the_origin():
    rng = np.random.default_rng(4)
    encoder = Encoder(amplitude_counts=800.0, cosine_offset=1.15, noise_lsb=0.5)
    sine, cosine = encoder.sample(wandering(300.0, rng, 6.0), rng)
    assert _reason(sine, cosine) == "monotonic"


def test_broken_tracks():
    rng = np.random.default_rng(5)
    sine, cosine = _tracks(wandering(300.0, rng, 6.0))
    for method in (calibrate_from_motion, calibrate_from_zero_crossings):
        assert _reason(sine, 0 * cosine, method) == "ellipse"
        assert _reason(sine, sine, method) == "ellipse"
        assert _reason(sine, np.rint(rng.normal(-sine, 2.0)), method) == "ellipse"
        assert _reason(rng.uniform(-1e3, 1e3, N), rng.uniform(-1e3, 1e3, N), method) == "ellipse"
        assert _reason(rng.normal(0.0, 300.0, N), rng.normal(0.0, 300.0, N), method) == "ellipse"


def test_too_few_samples():
    sine, cosine = _tracks(np.arange(float(N)) * 0.31)
    for method in (calibrate_from_motion, calibrate_from_zero_crossings):
        assert _reason(sine[:150], cosine[:150], method) == "samples"
        assert _reason([], [], method) == "samples"
        assert _reason(sine, np.full(N, np.nan), method) == "samples"
        assert _reason(sine, cosine, method, valid=np.zeros(N, np.bool_)) == "samples"


def _random_motion(rng: np.random.Generator, n: int) -> FloatArray:
    time = np.arange(n) / 1000.0
    speed = 10.0 ** rng.uniform(-1.0, 5.0)
    kind = rng.integers(0, 4)
    if kind == 0:
        return speed * time
    if kind == 1:
        corners = np.sort(rng.uniform(0.0, time[-1], 5))
        return np.cumsum(np.interp(time, corners, speed * rng.normal(size=5))) / 1000.0
    if kind == 2:
        size, frequency = 10.0 ** rng.uniform(-1.0, 2.0), 10.0 ** rng.uniform(-1.0, 1.5)
        return size * np.sin(2.0 * np.pi * frequency * time)
    return wandering(speed / 42.0, rng, n / 1000.0) + rng.normal(0.0, 10.0 ** rng.uniform(-5.0, -1.0), n)


@pytest.mark.parametrize("seed", range(12))
def test_what_is_accepted_is_as_good_as_it_says(seed):
    rng = np.random.default_rng(1000 + seed)
    encoder = random_encoder(rng, 10.0 ** rng.uniform(-0.5, 1.0))
    n = int(10.0 ** rng.uniform(2.5, 3.7))
    sine, cosine = encoder.sample(_random_motion(rng, n), rng)
    faulty = rng.random(n) < 10.0 ** rng.uniform(-5.0, -1.7)
    sine[faulty] = rng.integers(-2000, 2000, faulty.sum())
    try:
        result = calibrate_from_motion(sine, cosine)
    except CalibrationError:
        return
    assert np.abs(table_error(result.table, encoder)).max() < 2.0 * result.uncertainty_peak
    assert result.uncertainty_rms < 5e-4


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
@pytest.mark.parametrize("seed", range(2))
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
