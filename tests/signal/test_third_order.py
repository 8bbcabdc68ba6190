from __future__ import annotations

import math
from fractions import Fraction
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import canfb
from canfb.signal.limits import max_jerk
from canfb.signal.third_order import ThirdOrderTracker, step_weights, tracker_of
from canfb.signal.tracker import Track, TrackResult
from canfb.signal.tracking import track
from servo_kit import phases as phases_of
from servo_kit import servo_move

phases = st.floats(0, 1, exclude_max=True)
limits = st.floats(0.01, 0.5)
Row = tuple[int, float, float, bool]


def one_by_one(values: list[float], limit: float, speed: float = 0.0) -> list[Row]:
    tracker = ThirdOrderTracker(limit, speed)
    return [(*tracker.update(value),) for value in values]


def rows(result: TrackResult) -> list[Row]:
    columns = (result.cycles, result.phase, result.residual, result.ok)
    return list(zip(*(column.tolist() for column in columns), strict=True))


@given(st.lists(phases, max_size=60), limits, st.floats(-100, 100))
def test_the_array_path_gives_the_same_bits(values: list[float], limit: float, speed: float) -> None:
    assert rows(track(values, limit, speed, order=3)) == one_by_one(values, limit, speed)


@given(st.lists(st.one_of(phases, phases, phases, st.just(math.nan)), max_size=60), limits)
def test_also_with_samples_that_have_no_phase(values: list[float], limit: float) -> None:
    assert rows(track(values, limit, order=3)) == one_by_one(values, limit)


@given(st.integers(1, 300), st.integers(-300, 300), st.randoms())
def test_any_acceleration_is_followed_exactly_while_the_jerk_is_bounded(
    n: int, start_speed: int, random: Random
) -> None:
    position, speed, bend, truth = Fraction(0), Fraction(start_speed, 1024), Fraction(0), []
    for k in range(n):
        truth.append(position)
        if k > 1:
            bend += Fraction(random.randrange(-300, 301), 1024)
        position += speed + bend
        speed += bend
    result = track([float(p % 1) % 1.0 for p in truth], order=3)
    assert result.cycles.tolist() == [math.floor(p) for p in truth]
    assert result.ok.all()


def test_exact_more_than_ten_to_the_fifteenth_cycles_away() -> None:
    # Constant jerk of 5/16 cycle per interval cubed: exact in binary, closed form known.
    n = 300_000
    k = np.arange(n, dtype=object)
    sixteenths = 5 * k * (k - 1) * (k - 2) // 6
    result = track(np.array(sixteenths % 16, dtype=np.float64) / 16, order=3)
    assert (result.cycles == np.array(sixteenths // 16, dtype=np.int64)).all()
    assert result.cycles[-1] > 10**15
    assert (result.residual[3:] == 5 / 16).all()


@given(st.integers(-(10**30), 10**30), st.integers(-(10**9), 10**9), st.integers(-(10**6), 10**6), phases)
def test_the_scalar_path_has_no_limit_at_all(cycles: int, step: int, bend: int, p: float) -> None:
    tracker = ThirdOrderTracker(0.5)
    tracker.set_full_state(0.25, 0.5, 0.125, cycles, step, bend)
    c = 3.0 * 0.125 - 3.0 * 0.5 + 0.25 - p
    assert tracker.update(p).cycles == cycles + step + bend + round(c)


elapsed = st.sampled_from([0.5, 0.9, 1.0, 1.0, 1.001, 1.7, 2.0, 5.0])


@given(
    st.lists(elapsed, min_size=4, max_size=12), st.floats(-50, 50), st.floats(-3, 3), st.floats(-0.02, 0.02)
)
def test_samples_at_any_times_are_on_the_parabola_and_the_cubic_leaves_its_divided_difference(
    intervals: list[float], speed: float, acceleration: float, jerk: float
) -> None:
    times = np.concatenate(([0.0], np.cumsum(intervals)))
    at = [speed * t + acceleration * t**2 / 2.0 + jerk * t**3 / 6.0 for t in times.tolist()]
    places = [Track(math.floor(x), x - math.floor(x), 0.0, True) for x in at]
    tracker = ThirdOrderTracker(0.5)
    tracker.set_three(places[0], places[1], places[2], intervals[0], intervals[1])
    for k in range(3, len(at)):
        e, e1, e2 = intervals[k - 1], intervals[k - 2], intervals[k - 3]
        weight, weight_before = step_weights(e, e1, e2)
        foretold = at[k - 1] + weight * (at[k - 1] - at[k - 2]) - weight_before * (at[k - 2] - at[k - 3])
        left = jerk * e * (e + e1) * (e + e1 + e2) / 6.0
        assert at[k] - foretold == pytest.approx(left, abs=1e-8)
        guess = tracker.predict(e)
        assert guess.cycles + guess.phase == pytest.approx(foretold, abs=1e-8)
        if abs(left) < 0.45:
            got = tracker.look(places[k].phase, e)
            assert got[:2] == places[k][:2]
            assert got.residual == pytest.approx(abs(left), abs=1e-8)
        tracker.accept(places[k], e)


@given(phases, phases, phases, phases, st.integers(-200, 200), st.integers(-5, 5))
def test_equal_intervals_give_the_bits_of_the_plain_formula(
    p3: float, p2: float, p1: float, p: float, step: int, bend: int
) -> None:
    tracker = ThirdOrderTracker(0.5)
    tracker.set_full_state(p3, p2, p1, 7, step, bend)
    looked = tracker.look(p)
    c = 3.0 * (p1 - p2) + p3 - p
    assert looked == (7 + step + bend + round(c), p, abs(round(c) - c), abs(round(c) - c) < 0.5)
    if looked.ok:
        assert tracker.follow(p) == looked
    assert step_weights(1.0, 1.0, 1.0) == (2.0, 1.0)


def test_it_starts_by_half_a_cycle_then_by_constant_speed_then_by_constant_acceleration() -> None:
    tracker = ThirdOrderTracker(0.5)
    assert tracker.update(0.0) == (0, 0.0, 0.0, True)
    assert tracker.update(0.25) == (0, 0.25, 0.25, True)  # from standstill
    assert tracker.update(0.75) == (0, 0.75, 0.25, True)  # eq. 9: 0.5 foretold
    assert tracker.update(0.625) == (1, 0.625, 0.125, True)  # the parabola: 1.5 foretold
    tracker.restart(5, speed_cycles=83.25)
    assert [tracker.update(x).cycles for x in (0.0, 0.25, 0.5, 0.75)] == [5, 88, 171, 254]


def test_after_a_shift_of_the_speed_the_acceleration_is_the_same() -> None:
    tracker = ThirdOrderTracker(0.5)
    tracker.set_full_state(0.5, 0.5, 0.5, 0, 10, 3)
    tracker.shift(100, 7)
    assert tracker.full_state() == (0.5, 0.5, 0.5, 100, 17, 3)
    tracker.predict_by(2)
    assert tracker.look(0.5).cycles == 117
    tracker.predict_by(3)
    assert tracker.update(0.5).cycles == 117  # the acceleration was forgotten
    assert tracker.update(0.5).cycles == 134


def test_a_servo_move_at_1_khz_is_lost_by_the_second_order_and_counted_by_the_third() -> None:
    position = servo_move()
    phase = phases_of(position, np.random.default_rng(5))
    moved = position[-1] - position[0]
    off = {}
    for order in (2, 3):
        result = track(phase, 0.5, order=order)
        positions = result.cycles + result.phase
        off[order] = abs(positions[-1] - positions[0] - moved)
    assert off[2] > 1000.0
    assert 1e-6 < off[3] < 2e-3  # noise, and not less
    assert 0.312 < result.residual.max() < 0.316
    assert track(phase, 1 / 3, order=3).ok.all()


def test_the_jerk_of_the_largest_residual() -> None:
    assert max_jerk(2500, 1000) == pytest.approx(1_256_637, abs=1)
    assert canfb.max_jerk(2500, 1000, 0.25) == pytest.approx(628_319, abs=1)
    largest = max_jerk(2500, 1000, 1 / 3)
    for part, good in ((0.95, True), (1.05, False)):
        phase = phases_of(servo_move(rad_s3=part * largest), np.random.default_rng(7))
        result = track(phase, order=3)
        assert bool(result.ok.all()) is good
        assert result.residual.max() == pytest.approx(part / 3, abs=0.002)
    for bad in ((0, 1000, 0.5), (2500, 0, 0.5), (2500, 1000, 0.6)):
        with pytest.raises(ValueError, match="must be"):
            max_jerk(*bad)


@pytest.mark.parametrize("order", [0, 1, 4, 2.0, True, "3", None])
def test_another_order_is_refused(order: object) -> None:
    with pytest.raises(ValueError, match="order must be 2"):
        tracker_of(order)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="order must be 2"):
        track([0.5], order=order)  # type: ignore[arg-type]
