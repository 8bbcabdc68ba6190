"""Third-order prediction around faults: never valid and wrong, and what is lost."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import canfb
from canfb.objects import StatusBit
from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import ChainConfig
from canfb.signal.limits import PHASE_ERROR_CYCLES
from canfb.signal.recovery.jerk_recovery import JerkRecovery
from canfb.signal.recovery.parabola import MotionLimits, Parabola, Spot
from canfb.signal.sample import Sample
from canfb.signal.third_order import ThirdOrderTracker
from folding import each
from servo_kit import AMPLITUDE_COUNTS, IDEAL_TABLE, Array, cycles_of, phases, servo_move, tracks
from servo_kit import s_curve as s_curve_of

Rng = np.random.Generator
VALID, LOST, RESIDUAL = int(StatusBit.VALID), int(StatusBit.LOST), int(StatusBit.RESIDUAL)
SAMPLES, EPISODES = 80, 120
MARGIN = 8.0 * PHASE_ERROR_CYCLES


def limits_of(jerk: float) -> MotionLimits:
    return MotionLimits(jerk + MARGIN, 1.0 / 3.0, jerk)


def recovery_of(limits: MotionLimits, coast: int = 3) -> JerkRecovery:
    recovery = JerkRecovery(ThirdOrderTracker(limits.residual_limit), coast)
    recovery.set_motion(limits)
    return recovery


def constant(rng: Rng) -> Array:
    return np.full(SAMPLES, rng.uniform(-1.0, 1.0))


def bang_bang(rng: Rng) -> Array:
    return np.repeat(rng.choice([-1.0, 0.0, 1.0], SAMPLES), int(rng.integers(1, 13)))[:SAMPLES]


def white(rng: Rng) -> Array:
    return rng.uniform(-1.0, 1.0, SAMPLES)


def vibration(rng: Rng) -> Array:
    """10..200 Hz at 1 kHz."""
    return np.sin(2.0 * math.pi * (rng.uniform(0.01, 0.2) * np.arange(SAMPLES) + rng.uniform()))


def s_curve(rng: Rng) -> Array:
    jerk, first, length = np.zeros(SAMPLES), int(rng.integers(3, 40)), int(rng.integers(3, 20))
    jerk[first : first + length] = 1.0
    jerk[first + length + 5 : first + 2 * length + 5] = -1.0
    return jerk * rng.choice([-1.0, 1.0])


def torque_step(rng: Rng) -> Array:
    """The acceleration steps, once or twice: up to the limit of the jerk times an interval."""
    jerk = np.zeros(SAMPLES)
    jerk[rng.integers(4, SAMPLES, 2)] = rng.choice([-1.0, 1.0], 2)
    return jerk


MOTIONS = (constant, bang_bang, white, vibration, s_curve, torque_step)


def positions(motion: Callable[[Rng], Array], jerk: float, rng: Rng) -> Array:
    """From standstill; the third differences are those of the motion, times ``jerk``."""
    third = jerk * motion(rng)
    third[:3] = 0.0
    return rng.uniform() + np.cumsum(np.cumsum(np.cumsum(third)))


class Fault:
    """What the wire does to the phases, from ``at`` on."""

    def __init__(self, name: str, samples: int = 1) -> None:
        self.name, self.samples = name, samples

    def __call__(self, phase: Array, at: int, rng: Rng) -> tuple[Array, set[int]]:
        here = slice(at, at + self.samples)
        if self.name in ("lost", "bad"):
            return phase, set(range(at, at + self.samples))
        if self.name == "glitch":
            phase[here] = rng.uniform(size=self.samples)
        elif self.name == "small":
            phase[here] = (phase[here] + rng.uniform(-0.2, 0.2, self.samples)) % 1.0
        elif self.name == "swap":
            phase[at], phase[at + 1] = phase[at + 1], phase[at]
        elif self.name == "repeat":
            phase[at] = phase[at - 1]
        return phase, set()


def play(limits: MotionLimits, x: Array, fault: Fault, rng: Rng, uncorrected: float = 0.0) -> str:
    error = uncorrected * np.sin(8.0 * math.pi * x) + rng.normal(0.0, 1e-4, SAMPLES)
    at = int(rng.integers(20, 55))
    phase, gone = fault((x + error) % 1.0 % 1.0, at, rng)
    recovery, offset, wrong, bits = recovery_of(limits), None, False, 0
    for k, (here, p) in enumerate(zip(x.tolist(), phase.tolist(), strict=True)):
        if k in gone:
            track, bits = recovery.bad(1.0, missed=fault.name == "lost")
        else:
            track, bits = recovery.good(p, 1.0)
        away = track.cycles + track.phase - here
        offset = away if offset is None else offset
        wrong |= bool(bits & VALID) and abs(away - offset) > 0.5
    return "wrong" if wrong else "valid" if bits & VALID else "lost"


def outcomes(limits: MotionLimits, jerk: float, fault: Fault, uncorrected: float = 0.0) -> Counter[str]:
    counted: Counter[str] = Counter()
    for seed in range(EPISODES):
        rng = np.random.default_rng((seed, len(fault.name), fault.samples))
        x = positions(MOTIONS[seed % len(MOTIONS)], jerk, rng)
        counted[play(limits, x, fault, rng, uncorrected)] += 1
    return counted


@each("jerk", [0.01, 0.04, 0.065])
def test_one_lost_sample_never_costs_the_position_up_to_the_largest_jerk(jerk: float) -> None:
    # 4 j + 18 d < 1/2, with a real encoder without its table, too.
    assert outcomes(limits_of(jerk), jerk, Fault("lost")) == {"valid": EPISODES}
    assert outcomes(limits_of(jerk), jerk, Fault("lost"), uncorrected=0.011) == {"valid": EPISODES}


def test_at_half_the_limit_one_lost_sample_is_decided_up_to_a_sixth_of_a_cycle() -> None:
    # 4 (L + a) <= 1 with a = L / 2, nothing known but L.
    limits = MotionLimits(1.0 / 6.0, 1.0 / 3.0)
    assert outcomes(limits, 1.0 / 12.0 - 0.001, Fault("lost")) == {"valid": EPISODES}
    # Beyond it two motions may fit the next samples, and then the position is lost.
    beyond = outcomes(MotionLimits(1.0 / 3.0, 1.0 / 3.0), 1.0 / 6.0, Fault("lost"))
    assert beyond["wrong"] == 0
    assert beyond["lost"] > 0.8 * EPISODES


@each("fault", [Fault("lost", 2), Fault("lost", 3), Fault("bad", 2), Fault("bad", 3)])
def test_longer_gaps_are_right_or_lost(fault: Fault) -> None:
    for jerk in (0.01, 0.04):
        counted = outcomes(limits_of(jerk), jerk, fault)
        assert counted["wrong"] == 0
        assert counted["valid"] > (EPISODES // 2 if (fault.samples, jerk) == (2, 0.01) else -1)


@each("fault", [Fault("bad"), Fault("glitch"), Fault("small"), Fault("repeat")])
def test_one_bad_sample_is_bridged_and_never_leads_astray(fault: Fault) -> None:
    for jerk in (0.01, 0.04, 0.065):
        counted = outcomes(limits_of(jerk), jerk, fault)
        assert counted["wrong"] == 0
        assert counted["valid"] >= 0.85 * EPISODES


def test_two_swapped_samples_are_right_or_lost() -> None:
    for jerk in (0.01, 0.04):
        assert outcomes(limits_of(jerk), jerk, Fault("swap"))["wrong"] == 0


@each("part", [1.2, 1.7, 2.5, 4.0])
def test_a_jerk_beyond_its_limit_is_flagged_before_the_count_is_wrong(part: float) -> None:
    for jerk in (0.04, 0.065):
        for seed in range(20):
            rng = np.random.default_rng(seed)
            x = positions(MOTIONS[seed % len(MOTIONS)], part * jerk, rng)
            assert play(limits_of(jerk), x, Fault("none"), rng) != "wrong"


def test_an_acceleration_beyond_2010_02_is_flagged() -> None:
    limits = MotionLimits(0.14, 0.14, 0.04, acceleration=0.3)
    x = np.cumsum(np.cumsum(np.concatenate((np.zeros(10), np.minimum(0.03 * np.arange(30), 0.5)))))
    recovery = recovery_of(limits)
    bits = [recovery.good(p, 1.0)[1] for p in (x % 1.0).tolist()]
    first = next(k for k, bit in enumerate(bits) if bit != VALID)
    assert 0.3 < np.diff(x, 2)[first - 2] < 0.3 + 4 * PHASE_ERROR_CYCLES + 0.03
    assert bits[first] & RESIDUAL
    assert not any(bit & VALID for bit in bits[first:])


def test_the_window_is_that_of_the_derivation() -> None:
    limits = MotionLimits(0.4, 0.3, jerk=0.01)
    for missed, most in ((0, 0.01 + 8 * 0.0125), (1, 0.04 + 18 * 0.0125), (2, 0.1 + 32 * 0.0125)):
        assert limits.from_parabola(missed + 1.0, 1.0, 1.0) == pytest.approx(most)
    assert MotionLimits(0.1, 0.3).from_parabola(2.0, 1.0, 1.0) == pytest.approx(0.4)
    assert limits.from_line(1.0, 1.0, known_only=False) == pytest.approx(0.3)
    assert limits.from_line(2.0, 1.0, known_only=True) == math.inf
    known = MotionLimits(0.4, 0.3, acceleration=0.1)
    assert known.from_line(2.0, 1.0, known_only=True) == pytest.approx(0.1 * 3 + 6 * 0.0125)


@given(st.floats(0, 1, exclude_max=True), st.floats(-3, 3), st.floats(-3, 3), st.integers(1, 4))
def test_the_true_count_is_always_among_the_continuations(
    phase: float, speed: float, acceleration: float, missed: int
) -> None:
    jerk, limits = 0.05, limits_of(0.05)
    at = [phase + speed * k + acceleration * k * k / 2 for k in range(3)]
    end = 3 + missed - 1
    spots = tuple(Spot(math.floor(x), x - math.floor(x), float(k)) for k, x in enumerate(at))
    for part in (-0.99, 0.0, 0.99):
        gone = missed * (missed + 1) * (missed + 2) / 6.0 * part * jerk
        x = phase + speed * end + acceleration * end * end / 2 + gone
        counts = Parabola(spots).continuations(x - math.floor(x), float(end), limits)
        assert math.floor(x) in counts or abs(x - round(x)) < 1e-9


def test_lost_is_counted_by_eq_9_and_a_start_ends_it() -> None:
    recovery = recovery_of(limits_of(0.04))
    for k in range(10):
        assert recovery.good(0.25 * k % 1.0, 1.0)[1] == VALID
    recovery.lose()
    tracker = recovery.tracker
    assert isinstance(tracker, ThirdOrderTracker)
    assert (recovery.lost, recovery.order, tracker.order) == (True, 3, 2)
    assert recovery.good(0.5, 1.0)[1] == LOST
    recovery.vouch()
    assert tracker.order == 3
    assert recovery.good(0.75, 1.0)[1] == VALID
    recovery.restart()
    assert recovery.good(0.3, 1.0) == ((0, 0.3, 0.0, True), VALID)


def test_without_good_samples_it_is_lost_after_those_that_may_be_coasted() -> None:
    recovery = recovery_of(limits_of(0.01), coast=2)
    for k in range(20):
        recovery.good(0.1 * k % 1.0, 1.0)
    assert [recovery.bad(1.0, missed=True)[1] & LOST for _ in range(3)] == [0, 0, LOST]


# The whole chain


def chain_of(order: int = 3, **limits: float) -> SignalChain:
    return SignalChain(ChainConfig(adc_bits=12, prediction_order=order, **limits), IDEAL_TABLE)  # type: ignore[arg-type]


def test_the_servo_move_through_the_chain() -> None:
    x = servo_move()
    sine, cosine = tracks(x, np.random.default_rng(3))
    off = {}
    for order in (2, 3):
        chain = chain_of(order)
        got = [chain.step(Sample(s, c)) for s, c in zip(sine.tolist(), cosine.tolist(), strict=True)]
        moved = got[-1].cycles + got[-1].phase - got[0].cycles - got[0].phase
        off[order] = abs(moved - (x[-1] - x[0]))
        assert all(one.valid for one in got) is (order == 3)
        if order == 3:
            assert got[-1].speed_cycles == pytest.approx(125.0, abs=1e-3)
            assert max(one.acceleration_cycles for one in got) == pytest.approx(3.123, abs=5e-3)
    assert off[2] > 1.0
    assert off[3] < 2e-3


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10**6), st.integers(1, 90), st.sampled_from([0.12, 0.2, 1 / 3]))
def test_stream_arrays_and_single_samples_give_the_same_bits(seed: int, length: int, limit: float) -> None:
    rng = np.random.default_rng(seed)
    x = np.concatenate([positions(MOTIONS[seed % len(MOTIONS)], 0.02, rng) for _ in range(3)])
    x = np.cumsum(np.diff(x, prepend=x[0]) * (np.abs(np.diff(x, prepend=x[0])) < 30.0))
    sine, cosine = tracks(x, rng)
    for _ in range(int(rng.integers(0, 4))):
        at, n = int(rng.integers(0, len(x))), int(rng.integers(1, 4))
        sine[at : at + n] = rng.choice([0.0, 2047.0, -700.0])
    config = ChainConfig(residual_limit=limit, prediction_order=3, frozen_samples=5)
    chain = SignalChain(config, IDEAL_TABLE)
    single = [chain.step(Sample(s, c)) for s, c in zip(sine.tolist(), cosine.tolist(), strict=True)]
    blocks = [(sine[k : k + length], cosine[k : k + length]) for k in range(0, len(x), length)]
    for name in ("cycles", "phase", "residual", "status"):
        got = np.concatenate(
            [getattr(part, name) for part in canfb.process_stream(blocks, config, IDEAL_TABLE)]
        )
        assert got.tolist() == [getattr(one, name) for one in single]
    recovery = recovery_of(MotionLimits(limit, limit))
    result = canfb.process(sine, cosine, IDEAL_TABLE, limit, prediction_order=3)
    for k, phase in enumerate(IDEAL_TABLE(canfb.phase_in_cycle(sine, cosine)).tolist()):
        track, bits = recovery.bad(1.0) if math.isnan(phase) else recovery.good(phase, 1.0)
        assert (result.cycles[k], result.phase[k], result.residual[k]) == track[:3]
        assert bool(bits & VALID) is bool(result.ok[k])


def test_sample_times_make_up_for_the_jitter_of_a_fast_machine() -> None:
    rng = np.random.default_rng(9)
    times = np.arange(120.0) + rng.uniform(-0.1, 0.1, 120)  # 0.1 ms at 1 kHz, 125 cycles per interval
    x = cycles_of(1.0) * s_curve_of(314.0, 7850.0, 400_000.0, 1e-3 * (times - 10.0))
    sine, cosine = tracks(x, rng)
    chain = chain_of()
    chain.interval_s = 1e-3
    ticks = np.rint(times * 1e4).astype(int) + 1000
    got = [
        chain.step(Sample(s, c, time_100ns=int(t)))
        for s, c, t in zip(sine.tolist(), cosine.tolist(), ticks.tolist(), strict=True)
    ]
    assert all(one.valid for one in got)
    assert max(abs(one.cycles + one.phase - at) for one, at in zip(got, x.tolist(), strict=True)) < 0.01


def test_the_order_changes_while_the_machine_runs_and_the_position_stays() -> None:
    x = np.cumsum(np.minimum(0.1 * np.arange(200.0), 5.0))
    sine, cosine = tracks(x, np.random.default_rng(4))
    chain = chain_of(2)
    for k, (s, c) in enumerate(zip(sine.tolist(), cosine.tolist(), strict=True)):
        if k and k % 30 == 0:
            order = 3 if k % 60 else 2
            chain.set_limits(ChainConfig(prediction_order=order).chain_limits)
        got = chain.step(Sample(s, c))
        assert got.valid
        assert got.cycles + got.phase == pytest.approx(x[k], abs=0.01)


def test_eq_9_does_not_take_over_an_acceleration_that_it_cannot_follow() -> None:
    x = np.cumsum(np.cumsum(np.minimum(0.1 * np.arange(60.0), 2.0)))  # 2 cycles per interval squared
    sine, cosine = tracks(x, np.random.default_rng(4))
    chain = chain_of(3)
    for k, (s, c) in enumerate(zip(sine.tolist(), cosine.tolist(), strict=True)):
        if k == 50:
            chain.set_limits(ChainConfig(prediction_order=2).chain_limits)
        got = chain.step(Sample(s, c))
        assert got.valid is (k < 50)
    assert got.status & LOST


def test_the_coarse_track_confirms_a_speed_twice_before_the_position_is_valid() -> None:
    def run(acceleration: float) -> tuple[bool, float]:
        """A machine that turns and accelerates from the first sample on: is it ever valid, and how wrong."""
        chain = chain_of(3, coarse_limit_revolutions=1.0 / 256.0)
        k = np.arange(400.0)
        x = 40.25 * k + acceleration * k * k / 2.0
        sine, cosine = tracks(x, np.random.default_rng(6))
        angle = 2.0 * math.pi * x / 2500.0
        ever, worst = False, 0.0
        for n in range(len(k)):
            coarse = AMPLITUDE_COUNTS * math.sin(angle[n]), AMPLITUDE_COUNTS * math.cos(angle[n])
            got = chain.step(Sample(sine[n], cosine[n], coarse_sine=coarse[0], coarse_cosine=coarse[1]))
            if got.valid:
                ever = True
                worst = max(worst, abs(got.speed_cycles - float(x[n] - x[n - 1])))
        return ever, worst

    ever, worst = run(0.0)
    assert ever
    assert worst < 0.1
    assert run(1.0)[1] < 0.1  # eq. 9 begins with none, and that is never shown


def test_phases_of_the_kit_are_good() -> None:
    x = servo_move()
    assert np.abs((phases(x, np.random.default_rng(0)) - x + 0.5) % 1.0 - 0.5).max() < 5e-4
