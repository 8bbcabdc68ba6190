from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.signal.phase import FloatArray
from canfb.simulation.conventional import conventional_position, hardware_counter, quadrant
from canfb.simulation.encoder import Encoder

IDEAL = Encoder()
OFFSET = Encoder(amplitude_counts=1250.0, sine_offset=0.4, sine_amplitude=0.9, cosine_amplitude=1.1)


def wrong(encoder: Encoder, offset_cycles: float, fix: bool, noise_seed: int | None = None) -> float:
    """Part of the positions that are a cycle off, over all phases."""
    position = 1000.0 + 0.3719 * np.arange(40000)
    rng = None if noise_seed is None else np.random.default_rng(noise_seed)
    found = conventional_position(encoder, position, position + offset_cycles, fix, rng)
    return float(np.mean(np.abs(found.cycles + found.phase - position) > 0.5))


def test_quadrants_follow_the_cycle() -> None:
    middle = 2.0 * np.pi * np.array([0.125, 0.375, 0.625, 0.875])
    assert quadrant(np.sin(middle), np.cos(middle)).tolist() == [0, 1, 2, 3]
    assert quadrant(0.0, 1.0) == 0, "the positive zero crossing begins the cycle"


@given(st.floats(-1e6, 1e6))
def test_counter_counts_positive_zero_crossings(position: float) -> None:
    cycles, _ = hardware_counter(IDEAL, position)
    away = abs(position - round(position)) > 1e-8
    assert not away or cycles == np.floor(position)


def test_counter_of_an_encoder_with_offset_counts_where_its_sine_crosses_zero() -> None:
    crossing = -np.arcsin(0.4 / 0.9) / (2.0 * np.pi)
    around: FloatArray = np.array([5.0 + crossing - 1e-6, 5.0 + crossing + 1e-6])
    assert hardware_counter(OFFSET, around)[0].tolist() == [4, 5]
    assert hardware_counter(OFFSET, around)[1].tolist() == [3, 0]


@pytest.mark.parametrize("offset", [-0.2, -0.01, 0.01, 0.1, 0.24])
def test_without_the_fix_wrong_as_often_as_a_crossing_lies_between(offset: float) -> None:
    assert wrong(IDEAL, offset, fix=False) == pytest.approx(abs(offset), abs=0.002)


@pytest.mark.parametrize("offset", [-0.2495, -0.1, 0.0, 0.001, 0.1, 0.2495])
@pytest.mark.parametrize("noise_seed", [None, 3])
def test_fix_is_right_below_a_quarter_of_a_cycle(offset: float, noise_seed: int | None) -> None:
    assert wrong(IDEAL, offset, fix=True, noise_seed=noise_seed) == 0.0


@pytest.mark.parametrize("offset", [-0.45, -0.3, 0.26, 0.3, 0.45])
def test_fix_is_wrong_beyond(offset: float) -> None:
    assert wrong(IDEAL, offset, fix=True) == pytest.approx(2.0 * abs(offset) - 0.5, abs=0.002)


def test_fix_bears_less_where_an_offset_makes_a_quadrant_narrow() -> None:
    # The sine is negative for less than half the cycle; its last quadrant is the narrow one.
    narrow = 0.25 - np.arcsin(0.4 / 0.9) / (2.0 * np.pi)
    assert 0.17 < narrow < 0.18
    assert wrong(OFFSET, narrow - 0.002, fix=True) == 0.0
    assert 0.0005 < wrong(OFFSET, narrow + 0.002, fix=True) < 0.005


def test_noise_alone_makes_wrong_positions_without_the_fix() -> None:
    noisy = Encoder(noise_lsb=20.0)
    assert 1e-4 < wrong(noisy, 0.0, fix=False, noise_seed=1) < 1e-2
    assert wrong(noisy, 0.0, fix=True, noise_seed=1) == 0.0


def test_result_is_what_the_parts_give() -> None:
    found = conventional_position(IDEAL, [4.99], [5.01], fix=False)
    assert (found.cycles[0], found.counter_quadrant[0], found.adc_quadrant[0]) == (5, 0, 3)
    assert 0.98 < found.phase[0] < 1.0
    assert conventional_position(IDEAL, [4.99], [5.01]).cycles[0] == 4
    assert conventional_position(IDEAL, [5.01], [4.99]).cycles[0] == 5


def test_shapes_must_agree() -> None:
    with pytest.raises(ValueError, match="one shape"):
        conventional_position(IDEAL, [1.0, 2.0], [1.0])
