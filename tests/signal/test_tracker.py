import math
from fractions import Fraction
from random import Random

import pytest
from hypothesis import given, strategies as st

from canfb.signal.limits import max_acceleration, narrowed_residual_limit
from canfb.signal.tracker import Track, Tracker, split, track

phases = st.floats(0, 1, exclude_max=True)


@given(st.integers(1, 400), st.integers(-300, 300), st.randoms())
def test_any_speed_is_followed_exactly_while_the_acceleration_is_bounded(
    n: int, start_speed: int, random: Random
) -> None:
    position, speed, truth = Fraction(0), Fraction(start_speed, 1024), []
    for _ in range(n):
        truth.append(position)
        position += speed
        speed += Fraction(random.randrange(-300, 301), 1024)
    result = track([float(p % 1) % 1.0 for p in truth])
    assert result.cycles.tolist() == [math.floor(p) for p in truth]
    assert result.ok.all()


@given(st.integers(-(10**30), 10**30), st.integers(-(10**15), 10**15), phases, phases, phases)
def test_the_scalar_path_has_no_limit_at_all(cycles: int, step: int, p2: float, p1: float, p: float) -> None:
    tracker = Tracker()
    tracker.set_places(Track(cycles - step, p2, 0.0, True), Track(cycles, p1, 0.0, True))
    c = 2.0 * p1 - p2 - p
    assert tracker.update(p).cycles == cycles + step + round(c)


@given(phases, phases, st.integers(2, 50), st.integers(-400, 400))
def test_a_gap_of_n_intervals_is_stepped_over(first: float, move: float, gap: int, whole: int) -> None:
    speed = whole + move
    tracker = Tracker()
    tracker.update(first)
    tracker.set_places(Track(*split(first - speed), 0.0, True), Track(0, first, 0.0, True))
    position = first + gap * speed
    got = tracker.update(position % 1.0 % 1.0, elapsed=gap)
    assert got.cycles + got.phase == pytest.approx(position, abs=1e-9)
    assert got.residual < 1e-9
    assert tracker.step_cycles == pytest.approx(speed, abs=1e-9)
    following = tracker.update((position + speed) % 1.0 % 1.0)
    assert following.cycles + following.phase == pytest.approx(position + speed, abs=1e-6)


def test_the_residual_is_eq_12_and_the_limit_is_strict() -> None:
    tracker = Tracker(0.25)
    assert tracker.update(0.5) == (0, 0.5, 0.0, True)
    assert tracker.update(0.75) == (0, 0.75, 0.25, False)
    assert Tracker(0.26).update(0.0).ok


@pytest.mark.parametrize("phase", [-0.1, 1.0, 7.0, math.inf])
def test_a_phase_out_of_range_raises_at_once(phase: float) -> None:
    with pytest.raises(ValueError, match="0 <= phase < 1"):
        Tracker().update(phase)
    with pytest.raises(ValueError, match="0 <= phase < 1"):
        track([0.5, phase])


def test_eq_10_and_two_thirds_of_it() -> None:
    assert max_acceleration(2500, 25_000) == pytest.approx(785_398, abs=1)
    assert max_acceleration(2500, 25_000, 1 / 3) == pytest.approx(785_398 * 2 / 3, abs=1)
    assert max_acceleration(2500, 1000) == pytest.approx(1257, abs=0.5)
    for bad in ((0, 1000, 0.5), (2500, 0, 0.5), (2500, 1000, 0.6), (math.nan, 1000, 0.5), (10**400, 1, 0.5)):
        with pytest.raises(ValueError, match="must be"):
            max_acceleration(*bad)


def test_a_known_acceleration_narrows_the_limit() -> None:
    assert narrowed_residual_limit(1 / 3, 0.0, 2500, 1e-3) == 1 / 3
    sharp = narrowed_residual_limit(1 / 3, 20_000, 2500, 1 / 25_000)
    assert sharp == pytest.approx(0.0127 + 0.05, abs=1e-4)
    assert narrowed_residual_limit(1 / 3, 20_000, 2500, 1e-3) == 1 / 3
