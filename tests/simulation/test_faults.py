"""Each fault model: what it does to the counts, and that it does nothing before and after."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.simulation import faults
from canfb.simulation.encoder import Encoder
from canfb.simulation.faults import Fault, Samples, Signal
from folding import each

LENGTH, START, STOP = 60, 20, 35
SPAN = slice(START, STOP)
ENCODER = Encoder(noise_lsb=0.5)

ALL: tuple[Fault, ...] = (
    *(faults.OpenTrack(signal, 2.0) for signal in Signal),
    *(faults.ShortedTrack(signal, high) for signal in Signal for high in (False, True)),
    *(faults.StuckTrack(signal, counts) for signal in Signal for counts in (None, 321.0)),
    faults.JoinedTracks(),
    faults.SwappedTracks(),
    *(faults.InvertedTracks(signal) for signal in Signal),
    faults.TrackDrift(sine_offset=900.0, ramp_samples=10),
    faults.TrackDrift(cosine_gain=0.2, phase_rad=0.8, ramp_samples=10),
    *(faults.Oscillation(signal, 700.0, 0.13, 0.4) for signal in Signal),
    *(faults.ExcessNoise(signal, 300.0) for signal in Signal),
    faults.PhaseGlitch(1500.0),
    faults.PhaseGlitch(1500.0, common=True),
    faults.CountGlitch(),
    faults.LostSamples(),
    faults.FrozenSamples(),
    faults.RepeatedSamples(3),
    faults.LateSamples(2),
)


def clean(speed: float = 0.137, adc_bits: int = 12) -> Samples:
    positions = 0.3 + speed * np.arange(LENGTH)
    return Samples.of(*ENCODER.sample(positions, np.random.default_rng(1)), adc_bits=adc_bits)


def injected(fault: Fault, samples: Samples | None = None, start: int = START, stop: int = STOP) -> Samples:
    return fault.inject(samples or clean(), start, stop, np.random.default_rng(2))


def test_a_clean_recording_has_every_sample() -> None:
    samples = clean()
    assert len(samples) == LENGTH
    assert samples.delivered.all()
    assert samples.full_scale_counts == 2048


@pytest.mark.parametrize("fault", ALL, ids=str)
def test_nothing_happens_outside_the_span_and_the_input_stays_as_it_is(fault: Fault) -> None:
    before, untouched = clean(), clean()
    after = injected(fault, before)
    assert np.array_equal(before.sine, untouched.sine)
    assert np.array_equal(before.cosine, untouched.cosine)
    assert before.delivered.all()
    for part in (slice(0, START), slice(STOP, LENGTH)):
        assert np.array_equal(after.sine[part], before.sine[part])
        assert np.array_equal(after.cosine[part], before.cosine[part])
        assert after.delivered[part].all()
    assert (
        not np.array_equal(after.sine[SPAN], before.sine[SPAN])
        or not np.array_equal(after.cosine[SPAN], before.cosine[SPAN])
        or not after.delivered[SPAN].all()
    )


@pytest.mark.parametrize("fault", ALL, ids=str)
@given(start=st.integers(0, LENGTH - 1), length=st.integers(1, LENGTH))
def test_counts_are_those_of_a_converter(fault: Fault, start: int, length: int) -> None:
    after = injected(fault, None, start, min(LENGTH, start + length))
    for track in (after.sine, after.cosine):
        assert track.dtype == np.int64
        assert track.shape == (LENGTH,)
        assert track.min() >= -2048
        assert track.max() <= 2047


@each("fault", ALL)
@each("start, stop", [(-1, 5), (5, 5), (6, 5), (50, LENGTH + 1)])
def test_a_span_outside_the_samples_is_refused(fault: Fault, start: int, stop: int) -> None:
    with pytest.raises(ValueError, match="must hold"):
        injected(fault, None, start, stop)


def test_an_open_track_is_at_mid_scale() -> None:
    after = injected(faults.OpenTrack(Signal.SINE))
    assert (after.sine[SPAN] == 0).all()
    assert np.array_equal(after.cosine, clean().cosine)
    noisy = injected(faults.OpenTrack(Signal.COSINE, 5.0)).cosine[SPAN]
    assert 1.0 < noisy.std() < 15.0


@pytest.mark.parametrize(("high", "end"), [(False, -2048), (True, 2047)])
def test_a_shorted_track_is_at_an_end_of_the_converter(high: bool, end: int) -> None:
    assert (injected(faults.ShortedTrack(Signal.COSINE, high)).cosine[SPAN] == end).all()
    assert injected(faults.ShortedTrack(Signal.BOTH, high), clean(adc_bits=16)).full_scale_counts == 32768


def test_a_stuck_track_stays() -> None:
    before = clean()
    assert (injected(faults.StuckTrack(Signal.SINE, -77.0)).sine[SPAN] == -77).all()
    last = injected(faults.StuckTrack(Signal.COSINE))
    assert (last.cosine[SPAN] == before.cosine[START - 1]).all()
    assert np.array_equal(last.sine, before.sine)


def test_joined_tracks_show_their_mean() -> None:
    before, after = clean(), injected(faults.JoinedTracks())
    assert np.array_equal(after.sine[SPAN], after.cosine[SPAN])
    assert np.abs(after.sine[SPAN] - (before.sine + before.cosine)[SPAN] / 2).max() <= 0.5


def test_swapped_and_inverted_tracks() -> None:
    before = clean()
    swapped = injected(faults.SwappedTracks())
    assert np.array_equal(swapped.sine[SPAN], before.cosine[SPAN])
    assert np.array_equal(swapped.cosine[SPAN], before.sine[SPAN])
    inverted = injected(faults.InvertedTracks(Signal.COSINE))
    assert np.array_equal(inverted.sine, before.sine)
    assert np.array_equal(inverted.cosine[SPAN], -before.cosine[SPAN])


def test_an_inverted_track_keeps_the_ends_of_the_converter() -> None:
    lowest = Samples.of([-2048] * 3, [0] * 3)
    assert injected(faults.InvertedTracks(Signal.SINE), lowest, 0, 3).sine.tolist() == [2047] * 3


def test_a_drift_is_a_ramp_that_ends() -> None:
    still = Samples.of([100] * 30, [1000] * 30)
    offset = injected(faults.TrackDrift(sine_offset=50.0, ramp_samples=5), still, 10, 20).sine
    assert offset[9:21].tolist() == [100, 110, 120, 130, 140, 150, 150, 150, 150, 150, 150, 100]
    gain = injected(faults.TrackDrift(cosine_gain=0.5, ramp_samples=5), still, 10, 20).cosine
    assert gain[9:16].tolist() == [1000, 900, 800, 700, 600, 500, 500]


def test_a_phase_drift_turns_the_cosine_track() -> None:
    x = 2.0 * math.pi * np.arange(LENGTH) / 17.0
    samples = Samples.of(np.rint(1500 * np.sin(x)), np.rint(1500 * np.cos(x)))
    after = injected(faults.TrackDrift(phase_rad=0.3, ramp_samples=1), samples)
    assert np.abs(after.cosine[SPAN] - 1500 * np.cos(x - 0.3)[SPAN]).max() < 2.0
    assert np.array_equal(after.sine, samples.sine)


def test_an_oscillation_is_a_sine_on_top() -> None:
    still = Samples.of([0] * 40, [1000] * 40)
    after = injected(faults.Oscillation(Signal.BOTH, 200.0, 0.25), still, 0, 40)
    assert after.sine[:5].tolist() == [0, 200, 0, -200, 0]
    assert after.cosine[:5].tolist() == [1000, 1200, 1000, 800, 1000]


def test_excess_noise_is_independent_on_both_tracks() -> None:
    still = Samples.of([0] * 2000, [0] * 2000)
    after = injected(faults.ExcessNoise(Signal.BOTH, 100.0), still, 0, 2000)
    assert 90.0 < after.sine.std() < 110.0
    assert abs(np.corrcoef(after.sine, after.cosine)[0, 1]) < 0.1


def test_a_phase_glitch_has_a_good_amplitude_and_any_phase() -> None:
    still = Samples.of([0] * 2000, [1500] * 2000)
    after = injected(faults.PhaseGlitch(1500.0), still, 0, 2000)
    assert np.abs(np.hypot(after.sine, after.cosine) - 1500.0).max() < 1.0
    assert {(bool(s > 0), bool(c > 0)) for s, c in zip(after.sine, after.cosine, strict=True)} == {
        (True, True), (True, False), (False, True), (False, False),
    }  # fmt: skip
    common = injected(faults.PhaseGlitch(1500.0, common=True), still, 0, 2000)
    assert len(set(common.sine.tolist())) == 1


def test_a_count_glitch_reaches_the_whole_range() -> None:
    after = injected(faults.CountGlitch(), Samples.of([0] * 5000, [0] * 5000), 0, 5000)
    assert after.sine.min() < -2000
    assert after.sine.max() > 2000


def test_lost_samples_are_not_delivered() -> None:
    assert np.flatnonzero(~injected(faults.LostSamples()).delivered).tolist() == list(range(START, STOP))


def ramp() -> Samples:
    return Samples.of(np.arange(12), -np.arange(12))


def test_frozen_repeated_and_late_samples() -> None:
    frozen = injected(faults.FrozenSamples(), ramp(), 4, 8)
    assert frozen.sine.tolist() == [0, 1, 2, 3, 3, 3, 3, 3, 8, 9, 10, 11]
    twice = injected(faults.RepeatedSamples(), ramp(), 4, 9)
    assert twice.sine.tolist() == [0, 1, 2, 3, 3, 5, 5, 7, 7, 9, 10, 11]
    thrice = injected(faults.RepeatedSamples(3), ramp(), 4, 10)
    assert thrice.sine.tolist() == [0, 1, 2, 3, 3, 3, 6, 6, 6, 9, 10, 11]
    late = injected(faults.LateSamples(), ramp(), 4, 8)
    assert late.sine.tolist() == [0, 1, 2, 3, 3, 4, 5, 6, 8, 9, 10, 11]
    later = injected(faults.LateSamples(2), ramp(), 4, 8)
    assert later.sine.tolist() == [0, 1, 2, 3, 3, 3, 4, 5, 8, 9, 10, 11]
    for samples in (frozen, twice, thrice, late, later):
        assert np.array_equal(samples.cosine, -samples.sine)


def test_wrong_arguments_are_refused() -> None:
    with pytest.raises(ValueError, match="one length"):
        Samples.of([1, 2], [1])
    with pytest.raises(ValueError, match="adc_bits"):
        Samples.of([1], [1], adc_bits=3)
    with pytest.raises(ValueError, match="ramp_samples"):
        faults.TrackDrift(ramp_samples=0)
    with pytest.raises(ValueError, match="times"):
        faults.RepeatedSamples(1)
    with pytest.raises(ValueError, match="intervals"):
        faults.LateSamples(0)
