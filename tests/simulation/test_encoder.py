"""The simulated encoder and its analog path against their formulas, and each fault of its counts."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from canfb.simulation import faults
from canfb.simulation.encoder import AnalogPath, Encoder, Harmonic, Motion, ShaftEncoder, demo_encoder
from canfb.simulation.faults import Fault, Samples, Signal
from drawing import examples
from folding import each
from tools.faults.samples import tracks as more

HARMONICS = (Harmonic(2, 0.01, 0.02, 0.4, 1.1), Harmonic(5, 0.0, 0.03))
BENT = replace(demo_encoder(), amplitude_counts=1400.0, harmonics=HARMONICS, noise_lsb=0.0)


@given(st.floats(-100, 100))
def test_tracks_are_those_of_the_formulas_and_samples_are_rounded_to_counts(position: float) -> None:
    """BENT written out once more, with math and one number at a time."""
    x = 2 * math.pi * position
    sines = math.sin(x) + 0.01 * math.sin(2 * x + 0.4)
    cosines = math.cos(x - 0.05) + 0.02 * math.cos(2 * x + 1.1) + 0.03 * math.cos(5 * x)
    want = 1400 * (0.04 + 1.03 * sines), 1400 * (-0.03 + 0.96 * cosines)
    assert tuple(map(float, BENT.tracks(position))) == pytest.approx(want, abs=1e-7)
    sine, cosine = BENT.sample(position)
    assert max(abs(sine - want[0]), abs(cosine - want[1])) <= 0.5 + 1e-6
    assert sine.dtype == cosine.dtype == np.int64


@each("adc_bits", [4, 12, 16])
def test_the_converter_holds_at_both_ends(adc_bits: int) -> None:
    full = 1 << (adc_bits - 1)
    encoder = Encoder(amplitude_counts=2.0 * full, adc_bits=adc_bits)
    sine, cosine = encoder.sample([0.25, 0.75, 0.0, 0.5])
    assert sine.tolist() == [full - 1, -full, 0, 0]
    assert cosine.tolist() == [0, 0, full - 1, -full]
    just = Encoder(amplitude_counts=full - 1.0, adc_bits=adc_bits)
    assert just.sample(0.25)[0] == full - 1
    assert just.sample(0.75)[0] == 1 - full


def test_the_noise_has_the_strength_that_was_asked_for() -> None:
    """Gaussian before the converter, whose rounding adds 1/12 count squared; bounded on both sides."""
    encoder = Encoder(noise_lsb=0.8)
    positions = np.linspace(0, 1, 20_000)
    analog = np.array(encoder.tracks(positions))
    noise = np.array(encoder.sample(positions, np.random.default_rng(5))) - analog
    want = math.sqrt(0.8**2 + 1 / 12)
    assert np.std(noise, axis=1) == pytest.approx([want, want], rel=0.02)
    assert abs(noise.mean()) < 0.02
    assert abs(np.corrcoef(noise[0], noise[1])[0, 1]) < 0.03, "the tracks have noise of their own"
    assert abs(np.corrcoef(noise[0, 1:], noise[0, :-1])[0, 1]) < 0.03, "white"
    beyond = np.count_nonzero(np.abs(noise) > 3 * want) / noise.size
    assert 0.0005 < beyond < 0.006, "as often beyond three sigma as a Gaussian"


def test_without_a_generator_or_with_strength_zero_there_is_no_noise() -> None:
    quiet, loud = Encoder(), Encoder(noise_lsb=50.0)
    positions = np.linspace(0, 1, 100)
    want = np.array(quiet.sample(positions))
    assert np.array_equal(loud.sample(positions), want)
    assert np.array_equal(quiet.sample(positions, np.random.default_rng(1)), want)
    noisy = [np.array(loud.sample(positions, np.random.default_rng(seed))) for seed in (1, 1, 2)]
    assert np.array_equal(noisy[0], noisy[1])
    assert not np.array_equal(noisy[1], noisy[2])
    assert not np.array_equal(noisy[0], want)


def test_the_encoder_of_the_demo_is_mediocre_but_not_clipped() -> None:
    encoder = demo_encoder()
    sine, cosine = encoder.sample(np.linspace(0, 1, 5000), np.random.default_rng(1))
    for track in (sine, cosine):
        assert -2047 < track.min() < -1300
        assert 1300 < track.max() < 2046
    assert abs(sine.mean()) > 40
    assert abs(cosine.mean()) > 30


HERTZ = 125e3


def one_pole(track: np.ndarray, step_s: float, corner_hz: float) -> np.ndarray:
    """The exact response of a low-pass to a track that is held between its points."""
    part = 1.0 - math.exp(-2.0 * math.pi * corner_hz * step_s)
    out, value = np.empty(len(track)), float(track[0])
    for k, held in enumerate(track.tolist()):
        out[k] = value
        value += part * (held - value)
    return out


def test_the_steady_response_is_that_of_the_filter() -> None:
    step_s = 1e-9
    time = np.arange(80_000) * step_s
    plain = Encoder(harmonics=(Harmonic(3, 0.05, 0.03, 0.4, 1.0),), sine_offset=0.1)
    path = AnalogPath(sine_corner_hz=125e3, cosine_corner_hz=80e3, cosine_delay_s=1e-6)
    sine, cosine = plain.tracks(HERTZ * time)
    wanted = one_pole(sine, step_s, 125e3), one_pole(cosine, step_s, 80e3)
    steady = Encoder(harmonics=plain.harmonics, sine_offset=0.1, path=path)
    at = slice(50_000, 78_000)
    ours = steady.tracks(HERTZ * time[at], HERTZ)
    assert ours[0] == pytest.approx(wanted[0][at], abs=3.0)  # of 1500 counts, 1 ns
    assert ours[1] == pytest.approx(wanted[1][51_000:79_000], abs=3.0)


CORNERS = AnalogPath(sine_corner_hz=125e3, cosine_corner_hz=125e3)


@each("path, lag", [(CORNERS, math.atan(HERTZ / 125e3) / math.tau), (AnalogPath(delay_s=2e-6), HERTZ * 2e-6)])
def test_the_lag_is_that_of_the_phase(path: AnalogPath, lag: float) -> None:
    encoder = Encoder(path=path)
    sine, cosine = encoder.tracks(0.3, HERTZ)
    shown = math.atan2(float(sine), float(cosine)) / (2.0 * math.pi) % 1.0
    assert 0.3 - shown == pytest.approx(lag, abs=1e-12)


def test_a_shaft_knows_its_speed() -> None:
    shaft = ShaftEncoder(Encoder(path=CORNERS), 2500)
    motion = Motion((), start_rpm=3000.0)
    amplitudes = [math.hypot(*shaft.sample(k * 1e-3, motion.revolutions)[:2]) for k in range(1, 20)]
    assert np.mean(amplitudes) == pytest.approx(1500.0 / math.sqrt(2.0), rel=1e-3)


LENGTH, START, STOP = 60, 20, 35
SPAN = slice(START, STOP)
ENCODER = Encoder(noise_lsb=0.5)

ALL: dict[str, Fault] = {
    **{f"open {s.name}": faults.open_track(s, 2.0) for s in Signal},
    **{f"short {s.name} {high}": faults.shorted_track(s, high) for s in Signal for high in (False, True)},
    **{f"stuck {s.name} {at}": faults.stuck_track(s, at) for s in Signal for at in (None, 321.0)},
    "joined": faults.joined_tracks(),
    "swapped": faults.swapped_tracks(),
    **{f"inverted {s.name}": faults.inverted_tracks(s) for s in Signal},
    "offset": faults.track_drift(sine_offset=900.0, ramp_samples=10),
    "gain": faults.track_drift(cosine_gain=0.2, phase_rad=0.8, ramp_samples=10),
    **{f"oscillation {s.name}": faults.oscillation(s, 700.0, 0.13, 0.4) for s in Signal},
    **{f"noise {s.name}": more.excess_noise(s, 300.0) for s in Signal},
    "phase": more.phase_glitch(1500.0),
    "phases": more.phase_glitch(1500.0, common=True),
    "counts": more.count_glitch(),
    "lost": more.lost_samples(),
    "frozen": faults.frozen_samples(),
    "repeated": more.repeated_samples(),
    "late": more.late_samples(),
}


def clean() -> Samples:
    positions = 0.3 + 0.137 * np.arange(LENGTH)
    return Samples.of(*ENCODER.sample(positions, np.random.default_rng(1)), adc_bits=12)


def injected(fault: Fault, samples: Samples | None = None, start: int = START, stop: int = STOP) -> Samples:
    return fault.inject(samples or clean(), start, stop, np.random.default_rng(2))


@pytest.mark.parametrize("fault", ALL.values(), ids=ALL)
@examples(25)
@example(START, STOP - START)
@given(st.integers(0, LENGTH - 1), st.integers(1, LENGTH))
def test_within_the_span_are_other_counts_of_a_converter_and_nothing_happens_outside(
    fault: Fault, start: int, length: int
) -> None:
    """A part of them may have been what the fault makes of all: not so in the span of the other tests."""
    before, stop = clean(), min(LENGTH, start + length)
    after = injected(fault, before, start, stop)
    untouched = clean()
    changed = ~after.delivered
    for track, was, same in (
        (after.sine, before.sine, untouched.sine),
        (after.cosine, before.cosine, untouched.cosine),
    ):
        assert track.dtype == np.int64
        assert (track.shape, track.min() >= -2048, track.max() <= 2047) == ((LENGTH,), True, True)
        assert np.array_equal(was, same)
        changed |= track != was
    assert before.delivered.all()
    assert not changed[:start].any()
    assert not changed[stop:].any()
    assert changed.any() or (start, stop) != (START, STOP)


@each("fault", list(ALL.values()))
@each("start, stop", [(-1, 5), (5, 5), (6, 5), (50, LENGTH + 1)])
def test_a_span_outside_the_samples_is_refused(fault: Fault, start: int, stop: int) -> None:
    with pytest.raises(ValueError, match="must hold"):
        injected(fault, None, start, stop)


RISING = (np.arange(12), -np.arange(12))
STILL = ([100] * 12, [1000] * 12)
KEPT = [None] * 12  # In place of the counts of a track: as it was.


@each(
    "fault, start, stop, tracks, sine, cosine",
    [
        (faults.open_track(Signal.SINE), 4, 6, STILL, [100] * 4 + [0] * 2 + [100] * 6, KEPT),
        (faults.shorted_track(Signal.COSINE, False), 0, 12, STILL, KEPT, [-2048] * 12),
        (faults.shorted_track(Signal.COSINE, True), 0, 12, STILL, KEPT, [2047] * 12),
        (faults.stuck_track(Signal.SINE, -77.0), 11, 12, STILL, [100] * 11 + [-77], KEPT),
        (faults.stuck_track(Signal.COSINE), 9, 12, RISING, KEPT, [0, -1, -2, -3, -4, -5, -6, -7] + [-8] * 4),
        (faults.joined_tracks(), 0, 12, STILL, [550] * 12, [550] * 12),
        (faults.swapped_tracks(), 0, 12, STILL, [1000] * 12, [100] * 12),
        (faults.inverted_tracks(Signal.COSINE), 0, 12, STILL, KEPT, [-1000] * 12),
        (faults.inverted_tracks(Signal.SINE), 0, 3, ([-2048] * 3, [0] * 3), [2047] * 3, [0] * 3),
        (
            faults.track_drift(sine_offset=50.0, cosine_gain=0.5, ramp_samples=5), 4, 11, STILL,
            [100] * 4 + [110, 120, 130, 140, 150, 150, 150, 100],
            [1000] * 4 + [900, 800, 700, 600, 500, 500, 500, 1000],
        ),
        (
            faults.oscillation(Signal.BOTH, 200.0, 0.25), 0, 12, STILL,
            [100, 300, 100, -100] * 3, [1000, 1200, 1000, 800] * 3,
        ),
        (faults.frozen_samples(), 4, 8, RISING, [0, 1, 2, 3, 3, 3, 3, 3, 8, 9, 10, 11], None),
        (more.repeated_samples(), 4, 9, RISING, [0, 1, 2, 3, 3, 5, 5, 7, 7, 9, 10, 11], None),
        (more.late_samples(), 4, 8, RISING, [0, 1, 2, 3, 3, 4, 5, 6, 8, 9, 10, 11], None),
    ],
)  # fmt: skip
def test_the_counts_of_a_fault(
    fault: Fault, start: int, stop: int, tracks: Any, sine: list[int | None], cosine: list[int | None] | None
) -> None:
    before = Samples.of(*tracks)
    after = injected(fault, before, start, stop)
    expected = [-one for one in sine if one is not None] if cosine is None else cosine
    for found, was, wanted in ((after.sine, before.sine, sine), (after.cosine, before.cosine, expected)):
        assert found.tolist() == (was.tolist() if wanted == KEPT else wanted)


Tracks = Callable[[np.ndarray, np.ndarray], bool]


@each("fault, holds", [
    (faults.open_track(Signal.COSINE, 5.0), lambda s, c: 4.7 < c.std() < 5.3),
    (more.excess_noise(Signal.BOTH, 100.0), lambda s, c: 95.0 < s.std() < 105.0),
    (more.excess_noise(Signal.BOTH, 100.0), lambda s, c: abs(np.corrcoef(s, c)[0, 1]) < 0.1),
    (more.phase_glitch(1500.0), lambda s, c: np.abs(np.hypot(s, c) - 1500.0).max() < 1.0),
    (more.phase_glitch(1500.0), lambda s, c: len(set(zip(s > 0, c > 0, strict=True))) == 4),
    (more.phase_glitch(1500.0, common=True), lambda s, c: len(set(s.tolist())) == 1),
    (more.count_glitch(), lambda s, c: s.min() < -2000 and s.max() > 2000),
])  # fmt: skip
def test_the_counts_of_a_random_fault(fault: Fault, holds: Tracks) -> None:
    after = injected(fault, Samples.of([0] * 5000, [1500] * 5000), 0, 5000)
    assert holds(after.sine, after.cosine)


def test_a_phase_drift_turns_the_cosine_track() -> None:
    x = 2.0 * math.pi * np.arange(LENGTH) / 17.0
    samples = Samples.of(np.rint(1500 * np.sin(x)), np.rint(1500 * np.cos(x)))
    after = injected(faults.track_drift(phase_rad=0.3, ramp_samples=1), samples)
    assert np.abs(after.cosine[SPAN] - 1500 * np.cos(x - 0.3)[SPAN]).max() < 2.0
    assert np.array_equal(after.sine, samples.sine)


def test_lost_samples_are_not_delivered() -> None:
    assert np.flatnonzero(~injected(more.lost_samples()).delivered).tolist() == list(range(START, STOP))
