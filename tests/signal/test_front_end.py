"""What the analog path does at speed: a delay between the tracks, less amplitude, other harmonics."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from canfb import ChainConfig, Conditioning, Sample, SignalChain, StatusBit
from canfb.signal.front_end import NO_LOW_PASS, PLACES, SPEEDS, Corners, FrontEnd, corrected, harmonic_rows
from folding import each
from servo_kit import IDEAL_TABLE

INTERVAL_S = 1e-3
TICKS = 10_000  # of 100 ns in it
FAST = 125.037  # cycles per interval: 3000 rpm with 2500 cycles per revolution, and not locked
ELLIPSE = Conditioning(20.0, -30.0, 1.02, 0.97, 0.06, 1e-6)


def counts(
    position: float, speed: float, used: Conditioning, amplitude: float = 1500.0, corner_hz: float = 0.0
) -> tuple[float, float]:
    """Counts of an encoder that ``used`` conditions, at this position (cycles) and speed (per interval)."""
    x = 2.0 * math.pi * (position % 1.0)
    hertz = speed / INTERVAL_S
    turned = 2.0 * math.pi * hertz * used.cosine_delay_s
    size = amplitude / math.hypot(1.0, hertz / corner_hz) if corner_hz else amplitude
    return (
        used.sine_offset_counts + size / used.sine_gain * math.sin(x),
        used.cosine_offset_counts + size / used.cosine_gain * math.cos(x + turned - used.phase_error_rad),
    )


def chain_of(used: Conditioning, **others: float) -> SignalChain:
    config = ChainConfig(conditioning=used, interval_s=INTERVAL_S, **others)  # type: ignore[arg-type]
    return SignalChain(config, IDEAL_TABLE)


def ramp(acceleration: float, top: float, samples: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    """Position (cycles) and speed (per interval) at each sample, from standstill to ``top``."""
    k = np.arange(samples, dtype=float)
    turn = abs(top) / acceleration
    speed = np.minimum(acceleration * k, abs(top))
    position = np.where(k < turn, 0.5 * acceleration * k * k, abs(top) * (k - turn / 2.0))
    return math.copysign(1.0, top) * position + 0.1, math.copysign(1.0, top) * speed


@each("delay_s", [1e-6, -1e-6, 1e-7])
@each("top", [FAST, -FAST, 2.513])
def test_the_delay_is_removed_at_each_speed(top: float, delay_s: float) -> None:
    """Also on the ramp, and with an ellipse: what is left is the interpolation of the table."""
    encoder = replace(ELLIPSE, cosine_delay_s=delay_s)
    chain, away = chain_of(encoder), []
    for position, speed in zip(*ramp(0.1, top), strict=True):
        got = chain.step(Sample(*counts(position, speed, encoder)))
        assert got.valid, got
        away.append((got.cycles - position) + got.phase)
    found = np.array(away) - round(float(np.median(away)))
    assert 1e-10 < np.abs(found[-500:]).max() < 2e-6
    assert np.abs(found).max() < 2e-4, "where the acceleration begins or ends it is not known yet"


@each("kind", ["timed", "untimed"])
def test_the_interval_may_come_with_the_samples(kind: str) -> None:
    """Sample times, uneven by 3 us, say how long an interval is; without them the owner of the chain does."""
    rng = np.random.default_rng(1)
    chain = SignalChain(ChainConfig(conditioning=ELLIPSE), IDEAL_TABLE)
    if kind == "timed":
        chain.sync_interval_s = INTERVAL_S
    else:
        chain.use_interval(INTERVAL_S)
    chain.restart(0, 40.37)
    worst = 0.0
    for k in range(500):
        early = int(rng.integers(-30, 30)) if kind == "timed" else 0
        position = 0.1 + 40.37 * (k + early / TICKS)
        time = TICKS * k + early if kind == "timed" else None
        got = chain.step(Sample(*counts(position, 40.37, ELLIPSE), time_100ns=time))
        assert got.valid
        worst = max(worst, abs((got.cycles - position) + got.phase))
    assert worst < 2e-5


# The amplitude.


def test_the_amplitude_is_that_of_a_slow_machine() -> None:
    """A window of 0.9 to 1.1 holds from standstill to 3000 rpm, where the low-pass leaves 0.7.

    A track that falls short is flagged at speed as at standstill: 0.85 of the nominal amplitude.
    """
    narrow = {"amplitude_low_counts": 1350, "amplitude_high_counts": 1650}
    plain = Conditioning()
    with_corner = chain_of(plain, corner_hz=125e3, **narrow)
    without = chain_of(plain, **narrow)
    positions, speeds = ramp(0.1, FAST)
    flagged = 0
    for position, speed in zip(positions, speeds, strict=True):
        sample = Sample(*counts(position, speed, plain, corner_hz=125e3))
        got = with_corner.step(sample)
        assert got.valid
        assert got.amplitude == pytest.approx(1500.0, rel=0.005)
        flagged += bool(without.step(sample).status & StatusBit.AMPLITUDE)
    assert flagged > 1000
    weak = with_corner.step(Sample(*counts(positions[-1] + FAST, FAST, plain, 1275.0, 125e3)))
    assert weak.status & StatusBit.AMPLITUDE


# What it must not do.


def test_tracks_that_become_one_have_no_phase() -> None:
    """A quarter of a cycle between the samples: sine and cosine are the same."""
    front = FrontEnd(Conditioning(cosine_delay_s=1e-6), NO_LOW_PASS)
    front.use_interval(INTERVAL_S)
    assert front.coefficients(250.0) == (0.0,) * 5
    assert front.coefficients(200.0) != (0.0,) * 5


def test_uneven_times_do_not_tell_speeds_by_phases_that_depend_on_them() -> None:
    """A start in motion, with sample times: each speed would have other phases."""
    rng = np.random.default_rng(2)
    found = {}
    for name, used in (("with", ELLIPSE), ("without", replace(ELLIPSE, cosine_delay_s=0.0))):
        chain = SignalChain(ChainConfig(conditioning=used, max_acceleration_cycles=0.01), IDEAL_TABLE)
        chain.sync_interval_s = INTERVAL_S
        searched = False
        for k in range(40):
            early = int(rng.integers(-200, 200))
            pair = counts(0.1 + 40.37 * (k + early / TICKS), 40.37, used)
            chain.step(Sample(*pair, time_100ns=TICKS * k + early))
            searched |= chain.searches
        found[name] = searched
    assert found == {"with": False, "without": True}


@given(
    speed=st.floats(-200.0, 200.0),
    delay=st.floats(-1e-6, 1e-6),
    phase_error=st.floats(-0.5, 0.5),
    position=st.floats(0.0, 1.0),
)
def test_the_coefficients_undo_what_the_encoder_does(
    speed: float, delay: float, phase_error: float, position: float
) -> None:
    used = Conditioning(11.0, -7.0, 1.1, 0.9, phase_error, delay)
    front = FrontEnd(used, NO_LOW_PASS)
    front.use_interval(INTERVAL_S)
    offset_s, gain_s, offset_c, factor_c, skew = front.coefficients(speed)
    sine, cosine = counts(position, speed, used)
    if gain_s:
        s = (sine - offset_s) * gain_s
        c = (cosine - offset_c) * factor_c - s * skew
        assert (s, c) == pytest.approx(
            (1500.0 * math.sin(2 * math.pi * position), 1500.0 * math.cos(2 * math.pi * position)), abs=1e-6
        )


def test_no_harmonics_to_correct() -> None:
    used = Conditioning(cosine_gain=1.02, phase_error_rad=0.05, harmonic_3_forward_real=0.01)
    assert harmonic_rows(used, NO_LOW_PASS) is None
    assert harmonic_rows(Conditioning(cosine_delay_s=1e-6), Corners(1e5)) is None
    rows = harmonic_rows(used, Corners(1e5))
    assert rows is not None
    assert all(abs(value) < 1e-12 for value, _ in rows.row(0.0)), "a machine at standstill"
    assert rows.row(1e9) is rows.rows[-1]
    assert rows.row(-1e9) is rows.rows[0]
    assert len(rows.rows) == 2 * SPEEDS + 1
    assert harmonic_rows(used, Corners(1e5)) is rows, "made once"


@pytest.mark.parametrize("phase", [0.0, 1e-12, 0.4, 1.0 - 2**-53])
@pytest.mark.parametrize("by", [-0.01, 0.0, 0.01])
def test_a_phase_stays_in_its_cycle(phase: float, by: float) -> None:
    got = corrected(((by, 0.0),) * PLACES, phase)
    assert 0.0 <= got < 1.0
    away = phase - by - got
    assert away == pytest.approx(round(away), abs=1e-12)
