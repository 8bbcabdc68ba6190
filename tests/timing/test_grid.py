"""The grid: where an instant lies, whatever its jitter; and another grid."""

from __future__ import annotations

import itertools
import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.timing.grid import ROW, UNDECLARED, Grid, is_regular

UNITS = st.sampled_from([1e-3, 0.01, 10_000.0])  # seconds, and ticks
SEEDS = st.integers(0, 2**32)


def locked(
    period: float, jitter: float, seed: int, count: int = 60, declared: float = 0.0
) -> tuple[Grid, float]:
    """A grid after so many instants of a uniform jitter, and the place of the last one."""
    grid, draw = Grid(jitter=declared), random.Random(seed)
    for n in range(count):
        instant = n * period + draw.uniform(-jitter, jitter)
        if not n:
            grid.begin(instant)
        elif not grid.period:
            grid.learn(instant)
        else:
            places, off = grid.nearest(instant)
            assert places == 1
            assert abs(off) <= grid.allowed
            grid.follow(places, off)
    return grid, (count - 1) * period


@given(
    period=UNITS, part=st.floats(1e-6, 0.1), seed=SEEDS, places=st.integers(0, 40), off=st.floats(-0.3, 0.3)
)
def test_an_instant_is_at_the_nearest_place(
    period: float, part: float, seed: int, places: int, off: float
) -> None:
    """The line is better than its instants, none of which is further off than declared."""
    grid, last = locked(period, part * period, seed, declared=part * period)
    assert grid.locked
    assert grid.period == pytest.approx(period, rel=1e-9 + 0.02 * part)
    at, late = grid.nearest(last + (places + off) * period)
    assert at == places
    assert late == pytest.approx(off * period, abs=(0.001 + 1.5 * part) * period)


@pytest.mark.parametrize("declared", [0.0, 1e-4, 10.0])
def test_how_far_off_is_declared_and_never_learned(declared: float) -> None:
    grid, _ = locked(1e-3, 2e-5, 1, 500, declared)
    most = UNDECLARED * grid.period
    expected = min(most, declared * (1.0 + 3.0 * math.sqrt(2.0 / 256))) if declared else most
    assert grid.allowed == pytest.approx(expected)


@given(period=UNITS, shift=st.floats(0.1, 0.9), rate=st.sampled_from([1.0, 0.1, 0.5, 1.3, 2.0, 10.0]))
def test_regular_instants_off_the_grid_are_the_grid(period: float, shift: float, rate: float) -> None:
    grid, last = locked(period, 0.0, 1)
    row = [last + (1.0 + shift + n * rate) * period for n in range(ROW)]
    assert [grid.refuse(one) for one in row] == [False] * (ROW - 1) + [True]
    assert grid.set_again(row) is (rate != 1.0)
    assert grid.period == pytest.approx(rate * period)
    assert grid.due == pytest.approx(row[-1] + rate * period)


@given(instants=st.lists(st.floats(0.0, 100.0), min_size=ROW, max_size=ROW, unique=True).map(sorted))
def test_what_is_regular_agrees_within_a_fifth(instants: list[float]) -> None:
    apart = [b - a for a, b in itertools.pairwise(instants)]
    if is_regular(instants):
        assert max(apart) <= 1.201 / 0.799 * min(apart)


def test_a_pause_keeps_the_period() -> None:
    grid, _ = locked(1e-3, 0.0, 1)
    grid.pause()
    assert math.isnan(grid.due)
    grid.begin(100.0)
    assert (grid.period, grid.due) == (pytest.approx(1e-3), pytest.approx(100.001))
    grid.forget()
    assert grid.period == 0.0


@given(seed=SEEDS, latest=st.floats(0.05, 3.0))
def test_the_line_below_late_calls_is_that_of_the_instants(seed: int, latest: float) -> None:
    grid, draw = Grid(), random.Random(seed)
    grid.begin(0.0)
    n, taken = 0, 0.0
    while not grid.period:
        n += 1
        taken = max(
            taken, n + draw.uniform(0.0, latest) ** 2 / latest
        )  # a host that is late takes them in order
        grid.learn_earliest(taken)
    assert grid.period == pytest.approx(1.0, abs=0.03 + 0.08 * latest)
