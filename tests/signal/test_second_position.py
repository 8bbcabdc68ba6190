"""Increments to cycles against exact fractions: any scale, any wrap, any distance."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.signal.second_position import SecondScale, SecondSensor, step_increments
from canfb.signal.witness.witness import Pair, only_count
from folding import each

U32 = st.integers(1, 2**32 - 1)
FAR = st.integers(-(2**62), 2**62)
PHASES = st.floats(0.0, 1.0, exclude_max=True)


@given(U32, U32, st.booleans(), st.integers(1, 1048576), FAR, FAR, PHASES, PHASES)
def test_a_difference_is_the_nearest_float(
    increments: int, revolutions: int, reverse: bool, n: int, cycles: int, other: int, p: float, q: float
) -> None:
    scale = SecondScale(SecondSensor(increments=increments, revolutions=revolutions, reversed=reverse), n)
    per_increment = Fraction(n * revolutions, increments) * (-1 if reverse else 1)
    since, now = Pair(-7, p, 3, 0.0), Pair(cycles, q, other, 9.0)
    whole = float((other - 3) * per_increment - (cycles + 7))
    assert scale.difference_cycles(since, now) == whole - (q - p)
    assert scale.moved_cycles(since, now) == float((other - 3) * per_increment)
    assert scale.step_cycles == float(abs(per_increment))


@given(st.integers(-(2**31), 2**31 - 1), st.integers(-(2**31), 2**31 - 1))
def test_a_step_over_the_wrap_is_the_shorter_way(before: int, step: int) -> None:
    after = (before + step + 2**31) % 2**32 - 2**31
    assert step_increments(before, after) == step


@given(st.fractions(-50, 50), st.fractions(0, 3))
def test_one_count_and_no_other_is_within_the_limit(difference: Fraction, limit: Fraction) -> None:
    d, within = float(difference), float(limit)
    exact, most = Fraction(d), Fraction(within)
    fitting = [count for count in range(-60, 60) if abs(exact - count) <= most]
    near = any(abs(abs(exact - count) - most) < Fraction(1, 10**9) for count in range(-60, 60))
    if not near:  # a float may round the limit itself
        assert only_count(d, within) == (fitting[0] if len(fitting) == 1 else None)


@each("field, value", [
    ("increments", 0), ("increments", 2**32), ("increments", 1.0), ("revolutions", 0),
    ("tolerance_revolutions", -0.1), ("tolerance_revolutions", 0.26), ("tolerance_revolutions", math.nan),
    ("reversed", 1), ("invalidates", "no"),
])  # fmt: skip
def test_a_sensor_that_cannot_be(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=field):
        SecondSensor(**{field: value})  # type: ignore[arg-type]
