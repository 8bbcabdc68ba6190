"""The measured noise of the residual: right within any motion, and never widened by a fault."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.signal.feedback import Feedback
from canfb.signal.residual_noise import BLOCK_SAMPLES, FEWEST_BLOCKS, REFERENCE_BLOCKS, ResidualNoise
from canfb.signal.supervision import AMPLITUDE, VALID
from canfb.signal.third_order import tracker_of
from servo_kit import CYCLES_PER_REVOLUTION, s_curve

WEIGHTS = {2: math.sqrt(6.0), 3: math.sqrt(20.0)}


def feedbacks(positions: np.ndarray, order: int, status: int = VALID) -> list[Feedback]:
    """What the chain makes of these positions, cycles."""
    tracker, speed, made = tracker_of(order), 0.0, []
    for number, position in enumerate(positions.tolist()):
        track = tracker.update(position % 1.0 % 1.0)
        acceleration, speed = tracker.step_cycles - speed, tracker.step_cycles
        made.append(
            Feedback(0.0, 0.0, 1800.0, track.phase, track.cycles, track.phase, track.residual, status, speed,
                     acceleration, 0, number)
        )  # fmt: skip
    return made


def taken(noise: ResidualNoise, positions: np.ndarray, order: int) -> ResidualNoise:
    for feedback in feedbacks(positions, order):
        noise.take(feedback)
    return noise


def noisy(positions: np.ndarray, rms: float, seed: int = 1) -> np.ndarray:
    return positions + np.random.default_rng(seed).normal(0.0, rms, len(positions))


def constant_speed(samples: int, speed: float = 17.37) -> np.ndarray:
    return speed * np.arange(samples)


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("rms", [5e-5, 1e-3])
def test_at_constant_speed_it_is_the_rms_of_the_residual(order: int, rms: float) -> None:
    noise = taken(ResidualNoise(order), noisy(constant_speed(3000), rms), order)
    assert noise.rms_cycles == pytest.approx(rms * WEIGHTS[order], rel=0.3)
    assert rms * WEIGHTS[order] < noise.usable_cycles < 1.6 * rms * WEIGHTS[order]


def test_a_constant_acceleration_or_a_servo_move_does_not_show_in_it() -> None:
    rms, samples = 1e-4, np.arange(4000)
    ramp = noisy(0.1 * samples**2 / 2.0 + 0.0, rms)
    assert taken(ResidualNoise(2), ramp, 2).usable_cycles < 1.6 * rms * WEIGHTS[2]
    moves = [s_curve(100.0 * math.pi, 7850.0, 785e3, (samples[:400] - 20) / 2000.0)]
    while len(moves) < 12:  # up, and down again
        moves.append(moves[-1][-1] + (moves[-1][-1] - moves[-1][::-1]))
    cycles = np.concatenate(moves) / (2.0 * math.pi) * CYCLES_PER_REVOLUTION
    noise = taken(ResidualNoise(3), noisy(cycles, rms), 3)
    assert 0.7 * rms * WEIGHTS[3] < noise.usable_cycles < 3.0 * rms * WEIGHTS[3]


@pytest.mark.parametrize("speed", [0.0, 0.02, 3.0, 0.5])
def test_nothing_is_learned_where_errors_of_the_cycle_do_not_show(speed: float) -> None:
    noise = taken(ResidualNoise(), noisy(constant_speed(2000, speed), 1e-4), 2)
    assert math.isnan(noise.usable_cycles)


def test_flagged_samples_are_not_learned() -> None:
    noise = ResidualNoise()
    for feedback in feedbacks(noisy(constant_speed(4000), 1e-3), 2, VALID | AMPLITUDE):
        assert not noise.take(feedback)
    assert math.isnan(noise.rms_cycles)


def test_it_is_not_used_before_it_is_known() -> None:
    noise = ResidualNoise()
    blocks = 0
    for feedback in feedbacks(noisy(constant_speed(2000), 1e-4), 2):
        blocks += noise.take(feedback)
        assert math.isnan(noise.usable_cycles) == (blocks < FEWEST_BLOCKS)
    assert 4 * BLOCK_SAMPLES * blocks == pytest.approx(2000, abs=8 * BLOCK_SAMPLES)


@given(
    scales=st.lists(st.floats(1e-6, 0.1), min_size=1, max_size=40),
    seed=st.integers(0, 99),
    order=st.integers(2, 3),
)
def test_no_sequence_of_faults_widens_it_beyond_twice_the_reference(
    scales: list[float], seed: int, order: int
) -> None:
    """The first 32 blocks are the reference; whatever comes then, and however slowly it grows."""
    noise, rng = ResidualNoise(order), np.random.default_rng(seed)
    reference, taken = 0.0, 0
    for block in range(REFERENCE_BLOCKS + len(scales)):
        scale = 1e-4 if block < REFERENCE_BLOCKS else scales[block - REFERENCE_BLOCKS]
        done = False
        for sample in range(BLOCK_SAMPLES * 4 + order):
            acceleration = float(rng.normal(0.0, scale))
            taken += 1
            done |= noise.take(
                Feedback(0.0, 0.0, 1.0, 0.0, 0, sample % 8 / 8.0, 0.0, VALID, 7.3, acceleration, 0, taken)
            )
        assert done
        if block < REFERENCE_BLOCKS:
            reference = max(reference, noise.rms_cycles)
        assert not noise.usable_cycles > 2.0 * reference


def test_a_growing_fault_is_followed_only_so_far() -> None:
    """Noise that doubles every thousand samples: the usable one stops at twice that of the first 8192."""
    samples = np.arange(20_000)
    grown = 1e-5 * 2.0 ** (np.maximum(samples - 9000, 0) / 1000.0)
    positions = constant_speed(len(samples)) + np.random.default_rng(5).normal(0.0, 1.0, len(samples)) * grown
    noise, usable, measured = ResidualNoise(), [], []
    for feedback in feedbacks(positions, 2):
        if noise.take(feedback):
            usable.append(noise.usable_cycles)
            measured.append(noise.rms_cycles)
    first = max(measured[:REFERENCE_BLOCKS])
    assert measured[-1] > 50.0 * first  # what 2011:0B shows
    assert usable[-1] == 2.0 * first


def test_another_order_begins_anew() -> None:
    noise = taken(ResidualNoise(2), noisy(constant_speed(3000), 1e-4), 2)
    noise.order = 2
    assert noise.usable_cycles > 0.0
    noise.order = 3
    assert math.isnan(noise.usable_cycles)
