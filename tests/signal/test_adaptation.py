"""Offset, gain and phase of the tracks are followed: slowly, within bounds, and from good samples only."""

import math
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

import canfb
from canfb import ChainConfig, Conditioning, Feedback, Sample, SignalChain
from canfb.signal.adaptation import NO_DRIFT, AdaptConfig, FollowedDrift
from canfb.signal.correction import Correction
from canfb.signal.phase import raw_phases
from canfb.simulation.encoder import Encoder, Harmonic
from drawing import examples
from folding import each

AMPLITUDE = 1500.0
INTERVAL_S = 1e-3
FAST = AdaptConfig(rate_per_hour=10.0)  # a drift of 1 % in a second or two
ENCODER = Encoder(
    sine_offset=0.03,
    cosine_offset=-0.02,
    sine_amplitude=1.05,
    phase_error_rad=0.02,
    harmonics=(Harmonic(3, 0.01, 0.01), Harmonic(2, 0.005, 0.005)),
    noise_lsb=0.5,
)
Counts = tuple[np.ndarray, np.ndarray]
# Near k/n cycles per sample n phases repeat, and a thousand samples cover no cycle.
FAR_FROM_FRACTIONS = [math.sqrt(5.0) - 2.0, math.sqrt(2.0) / 2.0 - 0.5, 0.5 - math.sqrt(5.0) / 6.0]


@cache
def calibrated(conditioning: str | None = "fit") -> Correction:
    k = np.arange(20000)
    counts = ENCODER.sample(0.3 + 3.1371 * k + 0.8 * np.sin(3e-3 * k), np.random.default_rng(1))
    return canfb.calibrate_from_motion(*counts, conditioning).correction


def drifted(
    positions: np.ndarray,
    sine_offset: Any = 0.0,
    cosine_offset: Any = 0.0,
    gain: Any = 0.0,
    phase_rad: Any = 0.0,
    seed: int = 2,
) -> Counts:
    """Counts of the encoder with a drift, each a number or one for each sample; relative to the amplitude."""
    x, amplitude = 2.0 * math.pi * positions, ENCODER.amplitude_counts
    sine, cosine = ENCODER.tracks(positions)
    cosine = cosine + amplitude * (np.cos(x - 0.02 - phase_rad) - np.cos(x - 0.02))
    noise = np.random.default_rng(seed).normal(0.0, 0.5, (2, len(positions)))
    sine = (sine + amplitude * sine_offset) * (1.0 + 0.5 * gain) + noise[0]
    cosine = (cosine + amplitude * cosine_offset) * (1.0 - 0.5 * gain) + noise[1]
    return np.rint(sine), np.rint(cosine)


def chain_config(adapt: AdaptConfig | bool, used: Correction, **others: Any) -> ChainConfig:
    words: dict[str, Any] = {"interval_s": INTERVAL_S, "phase_error_cycles": 0.05} | others
    return ChainConfig(conditioning=used.conditioning, adapt=adapt, **words)


def chain_of(
    adapt: AdaptConfig | bool = FAST, correction: Correction | None = None, **others: Any
) -> SignalChain:
    used = calibrated() if correction is None else correction
    return SignalChain(chain_config(adapt, used, **others), used.table)


def taken(chain: SignalChain, counts: Iterable[np.ndarray]) -> list[Feedback]:
    """Each sample one interval after the one before."""
    pairs = zip(*(one.tolist() for one in counts), strict=True)
    return [chain.step(Sample(sine, cosine)) for sine, cosine in pairs]


def motion(samples: int, speed: float = 3.1371, start: float = 0.3) -> np.ndarray:
    """From standstill to a speed, cycles per sample, in 500 samples or fewer."""
    return start + np.cumsum(speed * np.minimum(np.arange(samples) / 500.0, 1.0))


@each("speed, conditioning", [(3.1371, "fit"), (0.0371, "fit"), (-0.7123, None)])
def test_a_drift_of_a_tenth_is_followed(speed: float, conditioning: str | None) -> None:
    """In an hour at 10 Hz. A table that corrects offsets, too, takes the first samples for calibrated."""
    samples = 36000
    positions, part = motion(samples, speed), np.arange(samples) / samples
    counts = drifted(positions, 0.1 * part, -0.1 * part, 0.1 * part)
    rms = []
    for adapt in (True, False):
        used = calibrated(conditioning)
        config = chain_config(adapt, used, interval_s=0.1)
        (got,) = canfb.process_stream([counts], config, used.table)
        assert got.valid.all()
        away = (got.cycles + got.phase - positions)[600:].reshape(-1, 2950)
        rms.append(away.std(axis=1).max())
    followed, without = rms
    assert without > 0.015
    assert 0.00003 < followed < 0.0003


@each("name, value", [("sine_offset", 0.05), ("cosine_offset", -0.05), ("gain", 0.05), ("phase_rad", 0.03)])
def test_each_drift_is_found_as_what_it_is(name: str, value: float) -> None:
    chain = chain_of()
    samples = 45000
    part = np.minimum(np.arange(samples) / 30000.0, 1.0)
    drift: dict[str, Any] = {name: value * part}
    taken(chain, drifted(motion(samples), **drift))
    found = chain.adaptation.drift
    sizes = {
        "sine_offset": found.sine_offset_counts / AMPLITUDE,
        "cosine_offset": found.cosine_offset_counts / AMPLITUDE,
        "gain": found.gain,
        "phase_rad": found.phase_rad,
    }
    assert sizes.pop(name) == pytest.approx(value, rel=0.06)
    assert all(abs(other) < 0.003 for other in sizes.values())


def test_the_range_is_bounded_and_its_end_is_reported() -> None:
    limits = AdaptConfig(offset=0.02, gain=0.03, phase_rad=0.01, rate_per_hour=10.0)
    chain = chain_of(limits)
    before = taken(chain, drifted(motion(5000)))
    assert before[-1].valid
    assert not chain.adaptation.at_limit
    samples = 40000
    part = np.arange(samples) / samples
    positions = motion(5000)[-1] + 3.1371 * np.arange(1, samples + 1)
    taken(chain, drifted(positions, 0.04 * part, -0.05 * part, 0.06 * part, 0.02 * part))
    sine, cosine, gain, phase = chain.adaptation.drift
    assert chain.adaptation.at_limit
    assert chain.adaptation.used > 1.5
    assert (sine, cosine) == pytest.approx((0.02 * AMPLITUDE, -0.02 * AMPLITUDE), rel=0.1)
    assert (gain, phase) == (pytest.approx(0.03), pytest.approx(0.01))
    back = positions[-1] + 3.1371 * np.arange(1, 20001)
    taken(chain, drifted(back))
    assert not chain.adaptation.at_limit


@each("speed", [0.0, 1.0, -3.0, 0.5, 1.0 / 3.0, 2.25, -0.2, 5.0 + 3.0 / 7.0, 7.0 / 12.0, 1.0 / 11.0])
def test_locked_speeds_and_standstill_freeze_it(speed: float) -> None:
    """The few phases that the samples meet are no cycle, whatever the drift is."""
    chain = chain_of(frozen_samples=0)
    turning = motion(3000)
    assert taken(chain, drifted(turning))[-1].valid
    # Behind half a second in which it slows down, the samples until then may still complete a cycle.
    speeds = np.concatenate((np.linspace(3.1371, speed, 500), np.full(20000, speed)))
    positions = turning[-1] + np.cumsum(speeds)
    counts = drifted(positions, np.concatenate((np.zeros(3500), np.full(17000, 0.05))))
    taken(chain, [one[:3500] for one in counts])
    before = chain.adaptation.drift
    got = taken(chain, [one[3500:] for one in counts])
    assert got[-1].valid
    assert chain.adaptation.drift == before
    assert not chain.adaptation.is_recent(got[-1].samples)


@each("reach", [0.02, 0.2, 0.4])
@each("middle", [0.0, 0.31])
def test_oscillation_around_a_phase_does_not_move_it(middle: float, reach: float) -> None:
    chain = chain_of()
    k = np.arange(30000)
    positions = middle + reach * np.sin(0.037 * k) * np.minimum(k / 500.0, 1.0)
    got = taken(chain, drifted(positions, 0.05, gain=0.05))
    assert got[-1].valid
    assert chain.adaptation.drift == NO_DRIFT


@each("faulty", ["flagged", "too large", "clipped", "one track", "lost"])
def test_wrong_samples_are_not_learned(faulty: str) -> None:
    """One in 300 of them, beside tracks that would be learned at once."""
    chain = chain_of(coast_samples=10)
    positions = motion(30000)
    counts = drifted(positions, 0.05, gain=0.05)
    for k, (sine, cosine) in enumerate(zip(*(one.tolist() for one in counts), strict=True)):
        sample = Sample(sine, cosine)
        if k % 300 == 250:
            if faulty == "lost":
                chain.miss()
                continue
            sample = {
                "flagged": Sample(sine, cosine, invalid=True),
                "too large": Sample(2.0 * sine, 2.0 * cosine),
                "clipped": Sample(2047.0, cosine),
                "one track": Sample(0.0, 0.0),
            }[faulty]
        chain.step(sample)
    assert chain.adaptation.drift == NO_DRIFT
    assert not chain.adaptation.is_recent(30000)


@each("track", ["sine_offset", "gain"])
@each("rate", [0.5, 10.0])
def test_a_growing_fault_is_found_within_the_bound(rate: float, track: str) -> None:
    """An offset that grows, a gain that falls: later than without, by no more than the ranges allow."""
    limits = AdaptConfig(rate_per_hour=rate)
    samples = 120000
    size = (0.9 if track == "sine_offset" else -1.6) * np.arange(samples) / samples
    positions = motion(samples, 3.1371)
    drift: dict[str, Any] = {track: size}
    counts = drifted(positions, **drift)
    at, reported = [], []
    for adapt in (False, limits):
        chain = chain_of(adapt, amplitude_low_counts=1200, amplitude_high_counts=1800, residual_limit=0.06)
        first = next(
            k
            for k, pair in enumerate(zip(*(one.tolist() for one in counts), strict=True))
            if not chain.step(Sample(*pair)).valid
        )
        at.append(abs(size[first]))
        reported.append(chain.adaptation.at_limit)
    without, with_it = at
    assert without < 0.7
    # A gain that differs by so much changes the amplitude by half of it.
    assert with_it < without + limits.hidden_amplitude / (1.0 if track == "sine_offset" else 0.5)
    assert reported[1]  # before it was found


@examples(25)
@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.integers(1, 400), min_size=1, max_size=8),
    st.sampled_from([0.0, 2e-5]),
)
def test_arrays_have_the_bits_of_single_samples(seed: int, blocks: list[int], delay_s: float) -> None:
    rng = np.random.default_rng(seed)
    samples = 1500
    positions = motion(samples, float(rng.choice(FAR_FROM_FRACTIONS)))
    sine_offset, cosine_offset, gain, phase_rad = rng.uniform(-0.05, 0.05, 4)
    sine, cosine = drifted(positions, sine_offset, cosine_offset, gain, phase_rad, seed)
    for place in rng.integers(0, samples, int(rng.integers(0, 3))):
        sine[place] = 2047.0
    used = calibrated()
    conditioning = replace(used.conditioning, cosine_delay_s=delay_s)
    words: dict[str, Any] = {"interval_s": 10.0 * INTERVAL_S, "adapt": FAST, "phase_error_cycles": 0.05}
    config = ChainConfig(conditioning=conditioning, **words)
    chain = SignalChain(config, used.table)
    got = taken(chain, (sine, cosine))
    ends = np.cumsum(blocks)
    parts = np.split(np.arange(samples), ends)
    results = list(canfb.process_stream([(sine[part], cosine[part]) for part in parts], config, used.table))
    for name in ("cycles", "phase", "residual", "amplitude", "status"):
        ours = np.concatenate([getattr(result, name) for result in results])
        assert np.array_equal(ours, [getattr(one, name) for one in got]), name
    if not (np.abs(sine) > 2046).any():
        assert chain.adaptation.drift != NO_DRIFT
        whole = canfb.process(sine, cosine, used.table, 1 / 3, conditioning, 0.0, **words)
        assert np.array_equal(whole.phase, [one.phase for one in got])


@given(
    st.tuples(*(st.floats(-0.2, 0.2) for _ in range(5))),
    st.tuples(*(st.floats(-0.2, 0.2) for _ in range(4))),
    st.floats(0.0, 1.0),
)
def test_the_conditioning_removes_what_the_drift_does(
    used: tuple[float, ...], drift: tuple[float, ...], phase: float
) -> None:
    """Counts of a drifted encoder become the circle, whatever the conditioning was before."""
    offset_s, offset_c, gain_s, gain_c, skew = used
    before = Conditioning(1000.0 * offset_s, 1000.0 * offset_c, 1.0 + gain_s, 1.0 + gain_c, skew)
    found = FollowedDrift(1000.0 * drift[0], 1000.0 * drift[1], drift[2], drift[3])
    angle = 2.0 * math.pi * phase
    sine = found.sine_offset_counts + (1.0 + found.gain / 2.0) * 1000.0 * math.sin(angle)
    cosine = found.cosine_offset_counts + (1.0 - found.gain / 2.0) * 1000.0 * math.cos(
        angle - found.phase_rad
    )
    raw_sine = sine / before.sine_gain + before.sine_offset_counts
    skewed = cosine * math.cos(skew) + sine * math.sin(skew)
    raw_cosine = skewed / before.cosine_gain + before.cosine_offset_counts
    assert before.apply(raw_sine, raw_cosine) == pytest.approx((sine, cosine), abs=1e-6)
    circle = 1000.0 * math.sin(angle), 1000.0 * math.cos(angle)
    assert found.removed_by(before).apply(raw_sine, raw_cosine) == pytest.approx(circle, abs=1e-6)


@given(
    st.tuples(*(st.floats(-1.0, 1.0) for _ in range(4))),
    st.tuples(st.floats(0.0, 0.25), st.floats(0.0, 0.5), st.floats(0.0, 0.25)),
)
def test_the_bound_of_what_it_hides(parts: tuple[float, ...], ranges: tuple[float, float, float]) -> None:
    """Any drift within the ranges, right or wrong, moves a phase by no more than is stated."""
    limits = AdaptConfig(offset=ranges[0], gain=ranges[1], phase_rad=ranges[2])
    drift = FollowedDrift(*np.multiply(parts, (limits.offset, limits.offset, limits.gain, limits.phase_rad)))
    x = 2.0 * np.pi * np.arange(360) / 360
    circle = np.sin(x), np.cos(x)  # behind the adaptation: its amplitude is 1
    sine = drift.sine_offset_counts + (1.0 + drift.gain / 2.0) * circle[0]
    cosine = drift.cosine_offset_counts + (1.0 - drift.gain / 2.0) * np.cos(x - drift.phase_rad)
    angle = np.angle(np.exp(1j * (np.arctan2(sine, cosine) - x))) / (2.0 * np.pi)
    raw = (raw_phases(sine, cosine) - raw_phases(*circle) + 0.5) % 1.0 - 0.5  # a position without a table
    assert max(np.abs(raw).max(), 4.0 / 3.0 * np.abs(angle).max()) <= limits.hidden_cycles + 1e-9
    # and the amplitude, in relation to the circle
    assert np.abs(np.hypot(sine, cosine) - 1.0).max() <= limits.hidden_amplitude + 1e-9


def test_activation_begins_at_zero_and_off_is_as_calibrated() -> None:
    chain = chain_of()
    positions = motion(40000)
    counts = drifted(positions, 0.05)
    taken(chain, [one[:20000] for one in counts])
    drift = chain.adaptation.drift
    assert drift.sine_offset_counts > 0.02 * AMPLITUDE
    chain.set_limits(ChainConfig(phase_error_cycles=0.05).chain_limits)
    assert chain.adaptation.drift == drift
    s, c = drift.removed_by(calibrated().conditioning).apply(counts[0][20000], counts[1][20000])
    got = chain.step(Sample(counts[0][20000], counts[1][20000]))
    assert (got.sine, got.cosine) == (pytest.approx(s), pytest.approx(c))
    chain.adapt(None)
    s, c = calibrated().conditioning.apply(counts[0][20001], counts[1][20001])
    got = chain.step(Sample(counts[0][20001], counts[1][20001]))
    assert (got.sine, got.cosine) == (pytest.approx(s), pytest.approx(c))
    assert chain.adaptation.drift == NO_DRIFT
    chain.adapt(FAST, drift)
    assert chain.adaptation.drift == drift
    chain.activate(calibrated())
    assert chain.adaptation.drift == NO_DRIFT
    assert chain.correction == calibrated()


def test_nothing_is_learned_while_the_interval_is_not_known() -> None:
    chain = chain_of(interval_s=0.0)
    taken(chain, drifted(motion(5000), 0.05))
    assert chain.adaptation.drift == NO_DRIFT
    chain.use_interval(INTERVAL_S)
    taken(chain, drifted(motion(5000)[-1] + 3.1371 * np.arange(1, 5001), 0.05))
    assert chain.adaptation.drift != NO_DRIFT
