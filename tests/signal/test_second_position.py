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


def test_days_at_full_speed_leave_no_error() -> None:
    """3000 rpm, a gear of 7 : 22, for a month; the increments in a revolution are no whole number."""
    n, turns = 2500, 3000 * 60 * 24 * 31
    scale = SecondScale(SecondSensor(increments=4096 * 22, revolutions=7), n)
    for extra in range(20):
        revolutions = 7 * (turns // 7) + extra
        increments = math.floor(Fraction(revolutions * 4096 * 22, 7))
        found = scale.difference_cycles(Pair(0, 0.0, 0, 0.0), Pair(revolutions * n, 0.0, increments, 1.0))
        assert -scale.step_cycles < found <= 0.0


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


@each("difference, limit, count", [
    (0.0, 0.4, 0), (0.4, 0.4, 0), (-3.2, 0.3, -3), (3.5, 0.4, None), (0.0, 0.999, 0), (0.5, 0.5, None),
    (0.1, 1.0, None), (0.3, 0.8, None), (0.3, 0.6, 0), (0.0, 25.0, None), (-0.5, 0.5, None),
])  # fmt: skip
def test_the_only_count(difference: float, limit: float, count: int | None) -> None:
    assert only_count(difference, limit) == count


@each("field, value", [
    ("increments", 0), ("increments", 2**32), ("increments", 1.0), ("revolutions", 0),
    ("tolerance_revolutions", -0.1), ("tolerance_revolutions", 0.26), ("tolerance_revolutions", math.nan),
    ("reversed", 1), ("invalidates", "no"),
])  # fmt: skip
def test_a_sensor_that_cannot_be(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=field):
        SecondSensor(**{field: value})  # type: ignore[arg-type]
