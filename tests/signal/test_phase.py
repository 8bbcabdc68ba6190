from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canfb.signal.phase import phase_in_cycle

values = st.floats(-1e300, 1e300, allow_subnormal=False) | st.sampled_from([math.nan, math.inf, -0.0])
counts = st.integers(-32768, 32767)


def bits(value: float) -> bytes:
    return np.float64(value).tobytes()


@given(st.one_of(values, counts), st.one_of(values, counts))
@example(math.inf, math.inf)
@example(0.0, -0.0)
def test_scalar_and_array_give_the_same_bits_and_a_phase_in_range(sine: float, cosine: float) -> None:
    one = phase_in_cycle(sine, cosine)
    many = phase_in_cycle(np.array([sine, 1.0]), np.array([cosine, 0.5]))
    assert isinstance(one, float)
    if sine == cosine == 0 or sine != sine or cosine != cosine or abs(sine) == abs(cosine) == math.inf:
        assert math.isnan(one)
        assert math.isnan(many[0])
    else:
        assert bits(one) == bits(many[0])
        assert 0.0 <= one < 1.0


@given(counts, counts, st.integers(1, 1000))
def test_a_common_amplitude_error_has_no_influence(sine: int, cosine: int, factor: int) -> None:
    if sine or cosine:
        assert phase_in_cycle(sine * factor, cosine * factor) == phase_in_cycle(sine, cosine)


@pytest.mark.parametrize(
    ("sine", "cosine", "phase"),
    [
        (0, 5, 0.0), (1, 8, 1 / 64), (5, 5, 0.125), (5, 0, 0.25), (5, -5, 0.375), (0, -5, 0.5),
        (-5, -5, 0.625), (-5, 0, 0.75), (-5, 5, 0.875), (-1, 8, 1 - 1 / 64), (8, -1, 0.25 + 1 / 64),
    ],
)  # fmt: skip
def test_table_1_at_its_corners(sine: int, cosine: int, phase: float) -> None:
    assert phase_in_cycle(sine, cosine) == phase


def test_the_phase_is_monotonic_and_continuous_and_at_most_1_132_percent_off() -> None:
    x = np.arange(1_000_000) / 1e6
    raw = phase_in_cycle(np.sin(2 * np.pi * x), np.cos(2 * np.pi * x))
    steps = np.diff(raw)
    assert steps.min() > 0.0
    assert steps.max() < 1.6e-6
    assert np.abs(raw - x).max() == pytest.approx(0.01132, abs=2e-5)


def test_small_integers_do_not_overflow() -> None:
    s, c = np.array([-32768, 100], np.int16), np.array([32767, 32767], np.int16)
    assert phase_in_cycle(s, c)[0] == phase_in_cycle(-32768, 32767)
    assert phase_in_cycle(s[0], c[0]) == phase_in_cycle(-32768, 32767)
