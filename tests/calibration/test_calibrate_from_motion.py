"""Right tables by both methods, which say the truth of themselves; a bad measurement is refused with why."""

import pickle

import numpy as np
import pytest
from measurements import (
    CYCLES_PER_REVOLUTION,
    PERCENT,
    RATE_HZ,
    extreme_encoder,
    measured,
    paper_motion,
    random_encoder,
    refusal,
    table_error,
    wandering,
)

from canfb import CalibrationError, CanfbError, Conditioning
from canfb.calibration.methods import calibrate_from_motion, calibrate_from_zero_crossings
from canfb.calibration.result import Calibration, Reason
from canfb.signal.phase import FloatArray, raw_phases
from canfb.simulation.encoder import Encoder, Harmonic
from folding import each


def _time(seconds: float) -> FloatArray:
    return np.arange(round(seconds * RATE_HZ)) / RATE_HZ


def _speeds(*points: tuple[float, float]) -> FloatArray:
    """Positions in cycles of a speed that is linear between these points (seconds, rpm)."""
    time = _time(points[-1][0])
    rpm = np.interp(time, [p[0] for p in points], [p[1] for p in points])
    return np.cumsum(rpm / 60.0 * CYCLES_PER_REVOLUTION) / RATE_HZ


def _check(result: Calibration, encoder: Encoder, goal: float) -> None:
    """The table is right, not suspiciously so, and does not claim more than is true."""
    peak = np.abs(table_error(result.table, encoder, result.conditioning)).max()
    assert 0.01 * goal < peak < goal
    assert peak < 1.3 * result.uncertainty_peak
    assert result.accepted
    assert result.reason == "accepted"


def _vibrating(size_cycles: float, frequency_hz: float) -> FloatArray:
    shaken = size_cycles * np.sin(2.0 * np.pi * frequency_hz * _time(6.0))
    return wandering(2000.0, np.random.default_rng(int(1000 * size_cycles)), 6.0) + shaken


HIGH = (Harmonic(7, 0.01, 0.01), Harmonic(9, 0.005, 0.006, 1.0), Harmonic(11, 0.01, 0.008, 0.3, 0.2))
LARGE = (Harmonic(2, 0.08, 0.07, 1.0, 2.0), Harmonic(3, 0.1, 0.08, 0.2), Harmonic(5, 0.03, 0.04, 2.0))
# Positions in cycles, and the goal in per cent.
MOTIONS = {
    "ramp to 3000 rpm and back": (_speeds((0.0, 0.0), (5.13, 3000.0), (10.0, 0.0)), 0.002),
    "reversals": (_speeds((0.0, 0.0), (2.03, 500.0), (5.11, -700.0), (8.0, 0.0)), 0.002),
    "slow reversals": (_speeds((0.0, 10.0), (4.0, -10.0), (8.0, 10.0)), 0.002),
    "long standstill": (_speeds((0.0, 0.0), (7.0, 0.0), (7.5, 60.0), (10.0, 90.0)), 0.002),
    "swinging": (20.0 * np.sin(2.0 * np.pi * 0.9 * _time(10.0)), 0.002),
    "a little vibration": (_vibrating(0.002, 47.0), 0.002),
    "vibration": (_vibrating(0.5, 47.0), 0.002),
    "much vibration": (_vibrating(2.0, 10.0), 0.002),
    "fast vibration": (_vibrating(0.01, 110.0), 0.01),
}
ENCODERS = {
    "the extreme case of the paper": extreme_encoder(np.random.default_rng(5), 1.2),
    "7th, 9th and 11th harmonic": Encoder(harmonics=HIGH, noise_lsb=0.5),
    "large harmonics": Encoder(harmonics=LARGE, noise_lsb=0.5),
    "phase error of 40 degrees": Encoder(phase_error_rad=0.7, noise_lsb=0.5),
    "16 bits": Encoder(amplitude_counts=25000.0, adc_bits=16, sine_offset=0.04, noise_lsb=5.0),
    "10 bits": Encoder(amplitude_counts=400.0, adc_bits=10, cosine_offset=0.04, noise_lsb=0.3),
}


@pytest.mark.parametrize("name", [*MOTIONS, *ENCODERS])
def test_any_motion_and_any_encoder(name):
    rng = np.random.default_rng(len(name))
    encoder = ENCODERS.get(name) or random_encoder(rng, 0.5)
    position, goal = MOTIONS.get(name) or (wandering(900.0, rng, 10.0), 0.003)
    _check(calibrate_from_motion(*encoder.sample(position, rng)), encoder, goal * PERCENT)


def test_unsteady_positions_are_averaged_and_told():
    rng = np.random.default_rng(4)
    encoder = random_encoder(rng, 0.5)
    position = wandering(300.0, rng, 10.0)
    result = calibrate_from_motion(*encoder.sample(position + rng.normal(0.0, 3e-3, len(position)), rng))
    _check(result, encoder, 0.05 * PERCENT)
    assert result.noise_cycles == pytest.approx(3e-3, rel=0.1)
    assert result.residual_rms == pytest.approx(3e-3, rel=0.1)
    # Vibration is no noise of the tracks: the bound does not know it.
    assert result.noise_counts < 2.0
    assert result.cramer_rao_ratio is not None
    assert result.cramer_rao_ratio > 5.0


def test_tracks_that_turn_backwards_give_a_table_that_fits():
    _, sine, cosine = measured(14, 900.0)
    plain, swapped = calibrate_from_motion(sine, cosine), calibrate_from_motion(cosine, sine)
    # Raw phase of swapped tracks is 1/4 less the raw phase, and so is the phase, but for a constant.
    raw = np.arange(1024) / 1024
    mirrored = plain.table(0.25 - raw) + swapped.table(raw)
    off = (mirrored - mirrored[0] + 0.5) % 1.0 - 0.5
    assert np.ptp(off) < 0.002 * PERCENT


@pytest.mark.parametrize("part", [0.01, 0.2])
def test_missed_samples_are_left_out(part):
    rng, (encoder, sine, cosine) = np.random.default_rng(1), measured(int(100 * part), 2000.0)
    valid = rng.random(len(sine)) > part
    marked = calibrate_from_motion(np.where(valid, sine, -5), np.where(valid, cosine, 0), valid=valid)
    _check(marked, encoder, 0.003 * PERCENT)
    assert marked.samples_used <= valid.sum()
    masked = np.ma.array(np.where(valid, sine, 999.0), mask=~valid)
    for without in (np.where(valid, sine, np.nan), np.where(valid, sine, 1e300), masked):
        assert calibrate_from_motion(without, cosine).table == marked.table


@pytest.mark.parametrize("part", [0.001, 0.03])
def test_faults_that_nobody_marked_are_left_out(part):
    rng, (encoder, sine, cosine) = np.random.default_rng(1), measured(int(1000 * part), 2000.0)
    kind = rng.choice(4, len(sine), p=[1.0 - part, part / 3.0, part / 3.0, part / 3.0])
    late_s, late_c = np.roll(sine, 1), np.roll(cosine, 1)
    wild = rng.integers(-2000, 2000, len(sine))
    sine = np.select([kind == 1, kind == 2, kind == 3], [wild, 0, late_s], sine)
    cosine = np.select([kind == 2, kind == 3], [0, late_c], cosine)
    result = calibrate_from_motion(sine, cosine)
    _check(result, encoder, 0.003 * PERCENT)
    assert result.samples_rejected >= 0.8 * np.sum(kind != 0)


@pytest.mark.parametrize("jitter_s", [1e-6, 1e-4])
@pytest.mark.parametrize("from_rest", [False, True])
def test_uneven_sample_times_are_used(jitter_s, from_rest):
    rng = np.random.default_rng(int(from_rest))
    encoder = random_encoder(rng, 0.5)
    time = _time(10.0) + rng.uniform(-jitter_s, jitter_s, 10000)
    speed = 2000.0 / 60.0 * CYCLES_PER_REVOLUTION
    position = speed * (time + 0.03 * np.sin(4.3 * time) / 4.3)
    if from_rest:
        position = np.where(time < 2.03, speed * time**2 / 4.06, speed * (time - 1.015))
        position += 20.0 * np.sin(4.3 * time)
    sine, cosine = encoder.sample(position, rng)
    _check(calibrate_from_motion(sine, cosine, time_s=time + 77.7), encoder, 0.002 * PERCENT)


@pytest.mark.parametrize("kind", [random_encoder, extreme_encoder])
def test_conditioning_is_fitted_used_and_left(kind):
    encoder, sine, cosine = measured(10, 700.0, kind=kind)
    fitted = calibrate_from_motion(sine, cosine, "fit")
    _check(fitted, encoder, 0.002 * PERCENT)
    given = calibrate_from_motion(sine, cosine, fitted.conditioning)
    assert given.conditioning == fitted.conditioning
    assert given.table == fitted.table
    left = calibrate_from_motion(sine, cosine)
    assert left.conditioning == Conditioning()
    assert left.before_rms > fitted.before_rms > 5e-3
    assert left.harmonics[0].amplitude_cycles > sum(h.amplitude_cycles for h in fitted.harmonics[:1])


def test_tracks_that_do_not_circle_the_origin_need_the_fit():
    rng = np.random.default_rng(11)
    encoder = Encoder(amplitude_counts=800.0, sine_offset=1.2, noise_lsb=0.5)
    tracks = encoder.sample(wandering(700.0, rng, 10.0), rng)
    _check(calibrate_from_motion(*tracks, "fit"), encoder, 0.004 * PERCENT)


def test_progress_rises_to_one():
    rng = np.random.default_rng(13)
    seen: list[float] = []
    tracks = Encoder(noise_lsb=0.5).sample(wandering(60.0, rng, 2.0), rng)
    calibrate_from_motion(*tracks, progress=seen.append)
    assert len(seen) >= 3
    assert seen == sorted(seen)
    assert seen[0] >= 0.0
    assert seen[-1] == 1.0


@pytest.fixture(scope="module")
def several() -> list[tuple[Encoder, Calibration]]:
    found = []
    for seed in range(12):
        rng = np.random.default_rng(100 + seed)
        encoder = random_encoder(rng, rng.uniform(0.4, 2.0))
        position = wandering(10.0 ** rng.uniform(1.0, 3.5), rng, 5.0)
        found.append((encoder, calibrate_from_motion(*encoder.sample(position, rng))))
    return found


def test_error_is_within_the_cramer_rao_bound_times_1_3(several):
    squares = [
        np.mean(table_error(result.table, encoder) ** 2) / result.bound_rms**2 for encoder, result in several
    ]
    # Some 8 degrees of freedom each, 12 times: the mean scatters by 15 %, its root by 7 %.
    assert 0.75 < np.sqrt(np.mean(squares)) < 1.3
    assert np.sqrt(np.max(squares)) < 2.5


def test_ratio_to_the_bound_is_measured_from_the_data_alone(several):
    ratios = [result.cramer_rao_ratio for _, result in several]
    assert 0.8 < np.sqrt(np.mean(np.square(ratios))) < 1.3
    assert max(ratios) < 1.8


def test_uncertainty_is_what_the_error_is(several):
    pairs = [(table_error(result.table, encoder), result) for encoder, result in several]
    rms = [np.std(error) / result.uncertainty_rms for error, result in pairs]
    peak = [np.abs(error).max() / result.uncertainty_peak for error, result in pairs]
    assert 0.6 < np.sqrt(np.mean(np.square(rms))) < 1.2
    assert 0.15 < np.median(peak) < 0.7
    assert max(peak) < 1.1


def test_residuals_are_those_of_fresh_data(several):
    for encoder, result in several:
        assert (result.coverage, result.samples_used) == (1.0, 5000)
        # Noise and rounding of a count.
        assert result.noise_counts == pytest.approx(np.hypot(encoder.noise_lsb, np.sqrt(1 / 12)), rel=0.05)
        rng = np.random.default_rng(1)
        position = wandering(333.0, rng, 2.0)
        raw = raw_phases(*(track.astype(float) for track in encoder.sample(position, rng)))
        for phase, rms in ((raw, result.before_rms), (result.table(raw), result.residual_rms)):
            off = (phase - position) % 1.0
            off = (off - np.angle(np.mean(np.exp(2j * np.pi * off))) / (2.0 * np.pi) + 0.5) % 1.0 - 0.5
            assert off.std() == pytest.approx(rms, rel=0.2)
        assert 3.0 * result.residual_rms < result.residual_peak < 7.0 * result.residual_rms
        assert result.before_rms < result.before_peak < 4.0 * result.before_rms


def test_curve_shows_the_error_before_and_none_after(several):
    for encoder, result in several:
        curve = result.curve
        assert len(curve.phase) == len(curve.before) == len(curve.after) == 64
        bins = 2.0 * result.residual_rms / np.sqrt(result.samples_used / 64.0)
        assert np.sqrt(np.mean(curve.after**2)) < 1.5 * bins
        # Where the phase steps by a simple fraction, the blocks take part of the error for motion.
        assert 0.5 * result.before_rms < np.std(curve.before) < 1.1 * result.before_rms
        # Raw phase is what the table corrects: before is the negative of what the table adds.
        added = result.table.entries - np.arange(len(result.table)) / len(result.table)
        seen = np.interp(curve.phase, result.table.entries, added - added.mean(), period=1.0)
        assert np.corrcoef(seen, -curve.before)[0, 1] > 0.98
        assert encoder.adc_bits == 12


def test_only_orders_that_are_there_are_kept(several):
    extra = [len(set(result.track_orders) - {1, 2, 3, 5}) for _, result in several]
    assert all(result.track_orders[0] == 1 for _, result in several)
    # One in 300 of the others passes by chance.
    assert sum(extra) <= 3


def test_harmonics_are_those_of_the_encoder():
    rng = np.random.default_rng(2)
    encoder = Encoder(harmonics=(Harmonic(3, 0.03, 0.03),), noise_lsb=0.5)
    result = calibrate_from_motion(*encoder.sample(wandering(500.0, rng, 5.0), rng))
    # sin + e sin 3x and cos + e cos 3x: the angle is ahead by e sin 2x.
    first = result.harmonics[0]
    assert first.order == 2
    assert first.amplitude_cycles == pytest.approx(0.03 / (2.0 * np.pi), rel=0.02)
    assert first.angle_rad == pytest.approx(-np.pi / 2.0, abs=0.02)
    assert all(h.amplitude_cycles < 0.05 * first.amplitude_cycles for h in result.harmonics[1:])
    assert result.track_orders == (1, 3)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("kind", "goal"),
    [
        (lambda rng, noise: Encoder(noise_lsb=noise), 0.02 * PERCENT),
        (random_encoder, 0.02 * PERCENT),
        (extreme_encoder, 0.05 * PERCENT),
    ],
)
def test_table_is_better_than_the_papers(kind, goal, seed):
    rng = np.random.default_rng(seed)
    encoder = kind(rng, 0.5)
    result = calibrate_from_zero_crossings(*encoder.sample(paper_motion(rng, 1.0), rng))
    error = table_error(result.table, encoder)
    assert 0.002 * PERCENT / 10.0 < np.abs(error).max() < goal / 4.0
    assert np.abs(error).max() < 1.5 * result.uncertainty_peak
    assert result.accepted
    assert result.coverage == 1.0
    assert 500 < result.cycles_used < 700
    # Noise of half a count and its rounding, and the same again from the crossings.
    assert 0.4e-4 < result.residual_rms < 2.5e-4
    assert result.before_rms > 20.0 * result.residual_rms


@each("sign, seconds, back, faults, goal, cycles", [
    (1.0, 0.06, 0, 0, 0.02, range(20, 25)),
    (1.0, 0.5, 8000, 0, 0.005, range(290, 310)),
    (-1.0, 0.5, 8000, 0, 0.005, range(290, 310)),
    (1.0, 0.5, 0, 60, 0.005, range(165, 185)),
])  # fmt: skip
def test_few_cycles_are_enough_and_reversals_and_faults_left_out(sign, seconds, back, faults, goal, cycles):
    rng = np.random.default_rng(7)
    encoder = random_encoder(rng, 0.5)
    way = sign * paper_motion(rng, seconds)
    sine, cosine = encoder.sample(np.append(way, way[:-1][::-1][:back]), rng)
    valid = np.ones(len(sine), np.bool_)
    marked, unmarked = np.split(rng.choice(len(sine), faults, replace=False), 2)
    sine[marked] = -sine[marked]
    valid[marked] = False
    cosine[unmarked] = rng.integers(-2000, 2000, len(unmarked))
    result = calibrate_from_zero_crossings(sine, cosine, valid=valid)
    assert result.cycles_used in cycles
    assert np.abs(table_error(result.table, encoder)).max() < goal * PERCENT
    valid[: len(way) // 2] = False  # though nothing is wrong there
    if seconds > 0.1:
        assert calibrate_from_zero_crossings(sine, cosine, valid=valid).cycles_used < 0.65 * max(cycles)


@pytest.mark.parametrize("entries", [32, 64, 1024])
def test_the_way_between_the_entries_counts_in_the_stated_error(entries):
    encoder = Encoder(sine_offset=0.07, cosine_amplitude=0.93, noise_lsb=0.3)
    tracks = encoder.sample(np.arange(4818) / 80.3, np.random.default_rng(1))
    result = calibrate_from_zero_crossings(*tracks, entries=entries)
    assert 0.1 < np.abs(table_error(result.table, encoder)).max() / result.uncertainty_peak < 1.0


@pytest.mark.parametrize("seed", [82, 179, 197])
def test_a_sample_at_the_end_of_the_cycle_counts_there(seed):
    """Among those at its begin it had spoilt their mean: 0.33 % of a cycle."""
    rng = np.random.default_rng(seed)
    per, cycles = rng.uniform(60, 500), int(rng.integers(20, 80))
    size, noise = rng.choice([1500.0, 1900.0]), rng.choice([1, 2, 3, 5])
    angle = 2.0 * np.pi * (np.arange(int(per * cycles)) / per + rng.random())
    tracks = [np.round(size * track(angle) + rng.normal(0, noise, len(angle))) for track in (np.sin, np.cos)]
    result = calibrate_from_zero_crossings(*tracks, adc_bits=12)
    assert np.abs(table_error(result.table, Encoder())).max() < 1.5 * result.uncertainty_peak


@pytest.mark.parametrize(
    ("every", "samples", "reason"), [(1, 1200, "cycles"), (4, 50_000, "speed"), (50, 50_000, "speed")]
)
def test_fewer_cycles_and_too_fast_are_refused(every, samples, reason):
    rng = np.random.default_rng(9)
    tracks = random_encoder(rng, 0.5).sample(paper_motion(rng, 1.0)[:samples:every], rng)
    assert refusal(calibrate_from_zero_crossings, *tracks).reason == reason


@pytest.mark.parametrize("conditioning", [None, "fit"])
def test_both_methods_give_one_table(conditioning):
    rng = np.random.default_rng(10)
    encoder = random_encoder(rng, 0.5)
    sine, cosine = encoder.sample(paper_motion(rng, 1.0), rng)
    slow = calibrate_from_zero_crossings(sine, cosine, conditioning)
    # The same encoder at 1 kHz: every 50th sample, and 8 s of them.
    far = paper_motion(rng, 8.0)[::50]
    fast = calibrate_from_motion(*encoder.sample(far, rng), slow.conditioning)
    difference = slow.table.entries - fast.table.entries
    # Not aligned: both must mean the same by phase 0.
    assert 1e-7 < np.abs(difference).max() < 0.01 * PERCENT
    assert slow.conditioning.is_identity == (conditioning is None)


WRONG = [("entries", 8, 64.5), ("conditioning", "ellipse"), ("valid", [True]), ("time_s", [0.0], [1j])]


@pytest.mark.parametrize("wrong", [{name: value} for name, *values in WRONG for value in values])
def test_wrong_arguments_raise(wrong):
    sine, cosine = Encoder().sample(np.arange(2000) / 50.0)
    for method in (calibrate_from_zero_crossings, calibrate_from_motion):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            method(sine, cosine, **wrong)


N = 6000


def _reason(sine, cosine, method=calibrate_from_motion, **options) -> str:
    error = refusal(method, sine, cosine, **options)
    assert isinstance(error, CanfbError)
    assert error.reason in list(Reason)
    assert len(str(error)) > 20
    assert pickle.loads(pickle.dumps(error)).reason == error.reason
    if error.calibration is not None:
        assert not error.calibration.accepted
        assert error.calibration.reason == error.reason
        assert error.calibration.verdict.startswith("refused")
    return error.reason


def _tracks(position: FloatArray, noise_lsb: float = 0.5):
    rng = np.random.default_rng(1)
    return random_encoder(rng, noise_lsb).sample(position, rng)


def _at_300_rpm(encoder: Encoder):
    rng = np.random.default_rng(2)
    return encoder.sample(wandering(300.0, rng, 6.0), rng)


def _jittering(position: FloatArray, rms: float) -> FloatArray:
    return position + np.random.default_rng(3).normal(0.0, rms, len(position))


def _to_and_fro(speed: float, period: float, steep: float) -> FloatArray:
    return np.cumsum(speed * np.clip(np.sin(2 * np.pi * K / period + 1.0) * steep, -1.0, 1.0))


K = np.arange(float(N))
AT_300_RPM = wandering(300.0, np.random.default_rng(5), 6.0)
SMALL = Encoder(amplitude_counts=540.0, adc_bits=10, noise_lsb=0.5)
LOCKED, NEARLY, TOO_LARGE = (1 / 2, 1 / 3, 2 / 7, 0.125, 1 / 16), (1, 1 / 2, 1 / 3), (2070.0, 2600.0, 1e4)
# Positions or tracks, and the reasons that may be given.
REFUSED = {
    "standstill": (np.full(N, 0.3), "coverage"),
    "part of a cycle": (np.linspace(0.0, 0.6, N), "coverage"),
    "few cycles": (np.linspace(0.0, 6.0, N), "cycles"),
    # A whole number of cycles per sample cannot be told from standstill.
    **{f"{speed} cycles per sample": (speed * K + 0.1, "coverage") for speed in (1.0, 83.0)},
    **{f"{speed:.3f} cycles per sample": (speed * K + 0.1, "locked") for speed in LOCKED},
    **{f"nearly {one:.3f}": ((one + 2e-5) * K, "locked coverage cycles ellipse") for one in NEARLY},
    **{f"amplitude {one:g}": (_at_300_rpm(Encoder(amplitude_counts=one)), "clipped") for one in TOO_LARGE},
    "noise of the tracks": (_tracks(AT_300_RPM, noise_lsb=300.0), "noise"),
    "noise of the position": (_jittering(AT_300_RPM, 0.06), "noise"),
    "no motion": (np.random.default_rng(3).uniform(0.0, 50.0, N), "noise"),
    "jitter of 20 us, 1.7 cycles": (83.0 * (_jittering(K, 0.02) + 30.0 * np.sin(K / 1e3)), "noise"),
    "one cycle, many times": (_to_and_fro(0.0194, 150.0, 1.25), "cycles"),
    "corners beyond the blocks": (_to_and_fro(0.138, 235.0, 3.4), "noise"),
    # Eq. 10 at 1 kHz allows half a cycle per sample squared; this is three times as much, to and fro.
    "too much acceleration": (15.0 * np.sin(K * 0.317), "noise locked"),
    "not around the origin": (_at_300_rpm(Encoder(amplitude_counts=800.0, cosine_offset=1.15)), "monotonic"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_calibrated_is_refused_with_the_reason(name):
    shown, reasons = REFUSED[name]
    assert _reason(*(shown if isinstance(shown, tuple) else _tracks(shown))) in reasons.split()


def test_tracks_that_reach_the_end_of_the_converter():
    near = Encoder(amplitude_counts=2040.0, noise_lsb=0.5)
    assert np.abs(table_error(calibrate_from_motion(*_at_300_rpm(near)).table, near)).max() < 3e-5
    assert _reason(*_at_300_rpm(SMALL), adc_bits=10) == "clipped"
    sine, cosine = (1.0 * track for track in _at_300_rpm(Encoder(amplitude_counts=2300.0)))
    sine[77] = 3000.0  # beyond the converter's range
    assert _reason(sine, cosine) == "clipped"
    with pytest.raises(ValueError, match="adc_bits"):
        calibrate_from_motion(*_at_300_rpm(near), adc_bits=8)
    sine, cosine = (2048 + track for track in _at_300_rpm(near))
    with pytest.raises(ValueError, match="none is below zero: subtract mid-scale"):
        calibrate_from_motion(sine, cosine, conditioning="fit", adc_bits=12)


@pytest.mark.parametrize("method", [calibrate_from_motion, calibrate_from_zero_crossings])
def test_broken_tracks_and_too_few_samples(method):
    rng = np.random.default_rng(5)
    sine, cosine = _tracks(AT_300_RPM)
    for other in (0 * cosine, sine, np.rint(rng.normal(-sine, 2.0))):
        assert _reason(sine, other, method) == "ellipse"
    for noise in (rng.uniform(-1e3, 1e3, (2, N)), rng.normal(0.0, 300.0, (2, N))):
        assert _reason(noise[0], noise[1], method) == "ellipse"
    for few in (sine[:150], sine[:0]):
        assert _reason(few, few, method) == "samples"
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
