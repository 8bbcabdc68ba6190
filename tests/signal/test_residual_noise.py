"""The measured noise of the residual: right within any motion, and never widened by a fault."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from canfb import Feedback, Tracker
from canfb.signal.residual_noise import BLOCK_SAMPLES, FEWEST_BLOCKS, REFERENCE_BLOCKS, ResidualNoise
from canfb.signal.supervision import AMPLITUDE, VALID

WEIGHTS = math.sqrt(6.0)


def feedbacks(positions: np.ndarray, status: int = VALID) -> list[Feedback]:
    """What the chain makes of these positions, cycles."""
    tracker, speed, made = Tracker(), 0.0, []
    for number, position in enumerate(positions.tolist()):
        track = tracker.update(position % 1.0 % 1.0)
        acceleration, speed = tracker.step_cycles - speed, tracker.step_cycles
        made.append(
            Feedback(0.0, 0.0, 1800.0, track.phase, track.cycles, track.phase, track.residual, status, speed,
                     acceleration, 0, number)
        )  # fmt: skip
    return made


def taken(noise: ResidualNoise, positions: np.ndarray) -> ResidualNoise:
    for feedback in feedbacks(positions):
        noise.take(feedback)
    return noise


def noisy(positions: np.ndarray, rms: float, seed: int = 1) -> np.ndarray:
    return positions + np.random.default_rng(seed).normal(0.0, rms, len(positions))


def constant_speed(samples: int, speed: float = 17.37) -> np.ndarray:
    return speed * np.arange(samples)


@pytest.mark.parametrize("rms", [5e-5, 1e-3])
def test_at_constant_speed_it_is_the_rms_of_the_residual(rms: float) -> None:
    noise = taken(ResidualNoise(), noisy(constant_speed(3000), rms))
    assert noise.rms_cycles == pytest.approx(rms * WEIGHTS, rel=0.3)
    assert rms * WEIGHTS < noise.usable_cycles < 1.6 * rms * WEIGHTS


@pytest.mark.parametrize("speed", [0.0, 0.02, 3.0, 0.5])
def test_nothing_is_learned_where_errors_of_the_cycle_do_not_show(speed: float) -> None:
    noise = taken(ResidualNoise(), noisy(constant_speed(2000, speed), 1e-4))
    assert math.isnan(noise.usable_cycles)


def test_flagged_samples_are_not_learned() -> None:
    noise = ResidualNoise()
    for feedback in feedbacks(noisy(constant_speed(4000), 1e-3), VALID | AMPLITUDE):
        assert not noise.take(feedback)
    assert math.isnan(noise.rms_cycles)


def test_it_is_not_used_before_it_is_known() -> None:
    noise = ResidualNoise()
    blocks = 0
    for feedback in feedbacks(noisy(constant_speed(2000), 1e-4)):
        blocks += noise.take(feedback)
        assert math.isnan(noise.usable_cycles) == (blocks < FEWEST_BLOCKS)
    assert 4 * BLOCK_SAMPLES * blocks == pytest.approx(2000, abs=8 * BLOCK_SAMPLES)


@given(scales=st.lists(st.floats(1e-6, 0.1), min_size=1, max_size=40), seed=st.integers(0, 99))
def test_no_sequence_of_faults_widens_it_beyond_twice_the_reference(scales: list[float], seed: int) -> None:
    """The first 32 blocks are the reference; whatever comes then, and however slowly it grows."""
    noise, rng = ResidualNoise(), np.random.default_rng(seed)
    reference, taken = 0.0, 0
    for block in range(REFERENCE_BLOCKS + len(scales)):
        scale = 1e-4 if block < REFERENCE_BLOCKS else scales[block - REFERENCE_BLOCKS]
        done = False
        for sample in range(BLOCK_SAMPLES * 4 + 2):
            acceleration = float(rng.normal(0.0, scale))
            taken += 1
            done |= noise.take(
                Feedback(0.0, 0.0, 1.0, 0.0, 0, sample % 8 / 8.0, 0.0, VALID, 7.3, acceleration, 0, taken)
            )
        assert done
        if block < REFERENCE_BLOCKS:
            reference = max(reference, noise.rms_cycles)
        assert not noise.usable_cycles > 2.0 * reference
