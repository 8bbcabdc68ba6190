"""The one way through a gap, against motions that are known and against brute force."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from canfb.signal.recovery.bridge import (
    CLEARLY,
    CLEARLY_CYCLES,
    MOST_WIDTH,
    SPARE_CYCLES,
    Gap,
    Place,
    accelerations,
    bridge,
    roughness,
    run_accelerations,
    speed,
)
from folding import each

LIMIT = 1 / 3


def place(position: float, elapsed: float = 1.0) -> Place:
    cycles = math.floor(position)
    return Place(cycles, position - cycles, elapsed)


def motion(bends: list[float], start: float = 0.3, speed: float = 0.0) -> list[float]:
    """Positions with these accelerations, after the first two."""
    speeds = itertools.accumulate(bends, initial=speed)
    return list(itertools.accumulate(speeds, initial=start))


def through(positions: list[float], before: int, gap: int, doubted: int = 3) -> tuple[int, int] | None:
    """What bridge makes of a gap of so many samples: cycle count and whole step."""
    run = positions[before + gap :]
    way = bridge([place(x) for x in positions[:before]], [x % 1.0 for x in run], gap + 1.0, doubted, LIMIT)
    return None if way is None else (way.cycles, way.step_cycles)


def truth(positions: list[float], before: int, gap: int) -> tuple[int, int]:
    first, second = positions[before + gap : before + gap + 2]
    return math.floor(first), math.floor(second) - math.floor(first)


ACCELERATION = st.floats(-0.3, 0.3)
GAP = st.integers(1, 6)


@given(st.floats(-130, 130), st.floats(0, 1), ACCELERATION, GAP)
def test_a_constant_acceleration_goes_on(start_speed: float, start: float, bend: float, gap: int) -> None:
    positions = motion([bend] * (14 + gap), start, start_speed)
    assert through(positions, 9, gap) == truth(positions, 9, gap)


@given(st.floats(-130, 130), ACCELERATION, ACCELERATION, GAP, st.integers(0, 20))
def test_an_acceleration_that_changes_is_followed_or_it_is_unclear(
    start_speed: float, old: float, new: float, gap: int, at: int
) -> None:
    """Once, anywhere: before the gap, in it, after it."""
    bends = [old if k < at else new for k in range(14 + gap)]
    positions = motion(bends, 0.3, start_speed)
    found = through(positions, 9, gap)
    assert found in (None, truth(positions, 9, gap))
    # d samples doubted and g lost: floor((d + g + 2)^2 / 4) times the width is safe below one cycle.
    if (5 + gap) ** 2 // 4 * (CLEARLY * abs(new - old) + CLEARLY_CYCLES) < 1.0 and abs(
        new - old
    ) < MOST_WIDTH:
        assert found is not None


@given(st.floats(-130, 130), st.lists(st.floats(-0.06, 0.06), min_size=16, max_size=16), st.integers(1, 3))
def test_no_way_is_wrong_while_the_gap_is_like_what_is_seen(
    start_speed: float, bends: list[float], gap: int
) -> None:
    seen = bends[:7] + bends[8 + gap :]
    assume(min(seen) <= min(bends) and max(bends) <= max(seen))
    positions = motion(bends, 0.3, start_speed)
    assert through(positions, 9, gap) in (None, truth(positions, 9, gap))


@each("sign", [1, -1])
@each("steps", [1, 2, 3, 4])
@each("bend", [0.32, 0.325, 0.333])
def test_an_acceleration_at_the_limit_that_ends_in_the_gap_is_unclear(
    bend: float, steps: int, sign: int
) -> None:
    positions = motion([0.0] * 8 + [sign * bend] * (steps + 3) + [0.0] * 8, 0.3, 5.0)
    assert through(positions, 10 + steps, 3) is None


@pytest.mark.parametrize(("push", "found"), [(0.009, True), (0.03, False), (0.2, False)])
def test_a_push_that_nobody_saw_the_like_of_is_no_way(push: float, found: bool) -> None:
    positions = motion([0.0] * 8 + [push] * 2 + [0.0] * 6, 0.3, 5.25)
    assert (through(positions, 9, 2) is not None) == found


@pytest.mark.parametrize(("gap", "found"), [(1, True), (6, True), (17, True), (18, False), (60, False)])
def test_how_long_a_gap_may_be(gap: int, found: bool) -> None:
    """Accelerations of half CLEARLY_CYCLES either way must not be worth a cycle: 20^2 / 4 of them are."""
    positions = motion([0.0] * (14 + gap), 0.3, 5.25)
    assert (through(positions, 9, gap, doubted=0) is not None) == found


@pytest.mark.parametrize("glitch", [0.1, -0.2, 0.3])
@pytest.mark.parametrize("length", [1, 2, 3])
def test_places_that_were_bad_already_are_left_out(glitch: float, length: int) -> None:
    positions = motion([0.0] * 20, 0.3, 5.25)
    bad = [x + (glitch if 10 - length <= k < 10 else 0.0) for k, x in enumerate(positions)]
    assert through(bad, 10, 1) == truth(positions, 10, 1)
    assert through(bad, 10, 1, doubted=length - 1) is None


def test_one_place_stands_still() -> None:
    way = bridge([place(5.25)], [0.25] * 4, 1.0, 3, LIMIT)
    assert way is not None
    assert way[:2] == (5, 0)
    assert way.width < 1e-6
    assert bridge([place(5.25)], [0.25, 0.55, 0.85, 0.15], 1.0, 3, LIMIT) is None


@given(
    st.integers(1, 5),
    st.lists(st.floats(-1, 1), min_size=6, max_size=6),
    st.floats(-0.3, 0.3),
    st.floats(0, 0.5),
)
def test_the_ways_hold_all_that_such_accelerations_can_do(
    intervals: int, parts: list[float], low: float, width: float
) -> None:
    """The way of any accelerations lies between the bounds, and the bounds are reached."""
    high = low + width
    bends = [low + (part + 1) / 2 * width for part in parts[: intervals + 1]]
    change = sum(bends)
    gap = Gap(intervals, sum((intervals - k) * bend for k, bend in enumerate(bends)), change, low, high)
    assert (0, 0) in list(gap.through(low, high))
    least, most = gap._displacements(low, high, change)
    early, late = sorted(bends, reverse=True), sorted(bends)
    for order in (early, late):
        assert least - 1e-9 <= sum((intervals - k) * bend for k, bend in enumerate(order)) <= most + 1e-9
    if width > 0.0:
        corner = [high] * 2 + [low] * (intervals - 1)
        least, most = gap._displacements(low, high, sum(corner))
        assert most == pytest.approx(sum((intervals - k) * bend for k, bend in enumerate(corner)), abs=1e-9)
        assert least == pytest.approx(sum(k * bend for k, bend in enumerate(corner)), abs=1e-9)


@given(st.integers(1, 5), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_what_a_way_needs_is_the_least_that_lets_it_through(
    intervals: int, way: float, change: float
) -> None:
    gap = Gap(intervals, way, change, -0.01, 0.01)
    needs = gap.needs(0, 0, 4.0)
    beyond = (needs - gap.width) / 2
    assert (0, 0) in list(gap.through(-0.01 - beyond - 1e-6, 0.01 + beyond + 1e-6))
    if beyond > 1e-5:
        assert (0, 0) not in list(gap.through(-0.01 - beyond + 1e-5, 0.01 + beyond - 1e-5))


def test_differences() -> None:
    places = [place(0.25), place(1.25), place(4.25, 2.0), place(6.75)]
    assert speed(places) == 2.5
    assert speed(places[:1]) == 0.0
    assert accelerations(places) == [1 / 3, 2 / 3], "between the middles of the intervals"
    assert accelerations(places[:2]) == []
    assert run_accelerations([0.0, 0.5, 0.25]) == [0.25]
    assert run_accelerations([0.0, 0.75, 0.25]) == [-0.25]
    assert roughness([]) == roughness([1.0]) == 0.0
    assert roughness([0.0, 0.0, 0.0, 0.0, 5.0, 5.0]) == 0.0
    assert roughness([0.0, 0.1, 0.0, 0.1, 0.0]) == pytest.approx(0.1)
    assert SPARE_CYCLES < CLEARLY_CYCLES
