"""Ways through a gap: what they predict, what they take, and when they are proven."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.signal.candidates import Candidate, Place, candidates
from canfb.signal.tracker import Track

CLOSE = 2.0**-5  # exact, and six samples prove it


def place(position: float, elapsed: float = 1.0) -> Place:
    cycles = math.floor(position)
    return Place(cycles, position - cycles, elapsed)


def at_speed(speed: float, start: float = 0.0, samples: int = 5) -> list[Place]:
    return [place(start + speed * k) for k in range(samples)]


def position(track: Track) -> float:
    return track.cycles + track.phase


class Curve:
    """A constant acceleration; with powers of two all of it is exact."""

    def __init__(self, speed: float, acceleration: float, start: float = 100.25) -> None:
        self.speed, self.acceleration, self.start = speed, acceleration, start

    def __call__(self, k: float) -> float:
        return self.start + self.speed * k + self.acceleration * k * k / 2

    def candidate(self, bend: float | None = None) -> Candidate:
        places = [place(self(k)) for k in range(-4, 1)]
        return Candidate(places, self.acceleration if bend is None else bend, CLOSE)


CURVES = [
    (0.0, 0.0), (0.375, 0.0), (-0.375, 0.0), (5.0, 0.0), (83.375, 0.0), (-83.375, 0.0), (0.0, 0.125),
    (0.0, -0.125), (10.5, 0.25), (-10.5, 0.25), (-83.25, -0.0625), (3.0, -0.5),
]  # fmt: skip


@pytest.mark.parametrize("gap", [1, 2, 3, 7, 40])
@pytest.mark.parametrize(("speed", "acceleration"), CURVES)
def test_the_prediction_goes_on_with_speed_and_acceleration(
    speed: float, acceleration: float, gap: int
) -> None:
    curve = Curve(speed, acceleration)
    candidate = curve.candidate()
    assert candidate.gap == 0.0
    candidate.wait(gap - 1)
    candidate.wait(1.0)
    assert candidate.gap == gap
    predicted = candidate.predict()
    assert position(predicted) == curve(gap)
    assert 0.0 <= predicted.phase < 1.0
    assert (predicted.residual, predicted.ok) == (0.5, False)


def test_a_phase_that_rounds_up_to_one_is_the_next_cycle() -> None:
    candidate = Candidate([Place(4, 1e-20, 1.0), Place(4, 0.0, 1.0)], 0.0, CLOSE)
    candidate.wait(1.0)
    assert candidate.predict() == (4, 0.0, 0.5, False)


def test_from_one_place_it_stands_still() -> None:
    candidate = Candidate([Place(4, 0.25, 1.0)], 0.0, CLOSE)
    candidate.wait(9.0)
    assert candidate.predict()[:2] == (4, 0.25)
    assert candidate.before == candidate.last == (4, 0.25, 0.0, True)
    assert candidate.elapsed == 1.0


@pytest.mark.parametrize("elapsed", [0.5, 2.0, 3.0])
@pytest.mark.parametrize("speed", [0.25, -0.25, 20.5, -20.5])
def test_the_speed_is_that_per_interval(speed: float, elapsed: float) -> None:
    candidate = Candidate([place(1.0), place(1.0 + speed * elapsed, elapsed)], 0.0, CLOSE)
    candidate.wait(1.0)
    assert position(candidate.predict()) == 1.0 + speed * (elapsed + 1)
    candidate.wait(1.5)
    assert position(candidate.predict()) == 1.0 + speed * (elapsed + 2.5)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("gap", "close"), [(1, CLOSE), (2, 1.5 * CLOSE), (3, 2 * CLOSE), (5, 3 * CLOSE)])
def test_how_close_it_must_come_grows_with_the_gap(gap: int, close: float, sign: int) -> None:
    def met(residual: float) -> int:
        candidate = Candidate(at_speed(5.0), 0.0, CLOSE)
        candidate.wait(float(gap))
        assert candidate.meet(residual % 1.0), "a miss before the first meeting is no end"
        return candidate.confirmed

    assert met(sign * close) == 1
    assert met(sign * close * (1 - 2**-30)) == 1
    assert met(sign * close * (1 + 2**-30)) == 0


def test_after_a_meeting_a_miss_is_its_end() -> None:
    candidate = Candidate(at_speed(0.0), 0.0, CLOSE)
    candidate.wait(1.0)
    assert candidate.meet(0.5)
    assert (candidate.gap, candidate.confirmed) == (1.0, 0)
    candidate.wait(1.0)
    assert candidate.meet(0.0)
    assert (candidate.gap, candidate.confirmed, candidate.elapsed) == (0.0, 1, 2.0)
    candidate.wait(1.0)
    assert not candidate.meet(0.5)


@pytest.mark.parametrize("gaps", [(1, 1, 1), (2, 1, 3), (4, 4, 1), (1, 7, 2)])
@pytest.mark.parametrize(("speed", "acceleration"), CURVES)
def test_a_meeting_sets_it_there_with_the_speed_of_then(
    speed: float, acceleration: float, gaps: tuple[int, ...]
) -> None:
    curve = Curve(speed, acceleration)
    candidate, k = curve.candidate(), 0
    for confirmed, gap in enumerate(gaps, start=1):
        before = candidate.last
        candidate.wait(gap)
        k += gap
        assert candidate.meet(curve(k) % 1.0)
        assert candidate.last == (math.floor(curve(k)), curve(k) % 1.0, candidate.last.residual, True)
        assert candidate.last.residual == pytest.approx(0.0, abs=1e-9)
        assert (candidate.before, candidate.elapsed) == (before, gap)
        assert (candidate.gap, candidate.confirmed) == (0.0, confirmed)
    for ahead in (1, 2, 5):
        candidate.wait(ahead)
        k += ahead
        assert position(candidate.predict()) == pytest.approx(curve(k), abs=1e-9)
        candidate.wait(-ahead)
        k -= ahead


@pytest.mark.parametrize("gap", [0.5, 1.5, 2.25])
@pytest.mark.parametrize("speed", [0.25, -0.25, 40.5, -40.5])
def test_gaps_need_not_be_whole(speed: float, gap: float) -> None:
    candidate = Candidate(at_speed(speed), 0.0, CLOSE)
    candidate.wait(gap)
    there = speed * (4 + gap)
    assert candidate.meet(there % 1.0)
    assert position(candidate.last) == there
    candidate.wait(1.0)
    assert position(candidate.predict()) == pytest.approx(there + speed, abs=1e-9)


def test_the_residual_of_a_meeting_is_told() -> None:
    candidate = Candidate(at_speed(5.0), 0.0, CLOSE)
    candidate.wait(1.0)
    assert candidate.meet(0.0078125)
    assert candidate.last == (25, 0.0078125, 0.0078125, True)
    candidate.wait(1.0)
    assert candidate.predict()[:2] == (30, 0.015625), "the small difference belongs to the speed"


@pytest.mark.parametrize(
    ("close", "samples"),
    [(0.008, 4), (0.0094, 4), (0.00941, 5), (0.0208, 5), (0.0209, 6), (0.0353, 6), (0.0355, 7), (0.055, 8)],
)
def test_so_many_samples_in_a_row_prove_it(close: float, samples: int) -> None:
    candidate = Candidate(at_speed(0.25), 0.0, close)
    for k in range(1, samples + 1):
        assert not candidate.proven
        candidate.wait(1.0)
        assert candidate.meet(k * 0.25 % 1.0)
    assert candidate.proven
    assert (2 * close) ** samples * 8 <= 1e-6 < (2 * close) ** (samples - 1) * 8, "by chance so seldom"


def met_after_one(candidate: Candidate, phase: float) -> bool:
    candidate.wait(1.0 - candidate.gap)
    candidate.meet(phase % 1.0)
    return candidate.confirmed == 1


def wobbling(bend: float) -> list[Place]:
    """At rest but for one step of ``bend`` cycles to and fro: accelerations of +bend and -bend."""
    return [place(10.5), place(10.5), place(10.5 + bend), place(10.5 + bend)]


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("places", "close"),
    [
        (at_speed(0.5), 0.008),
        (at_speed(-83.5), 0.008),
        (wobbling(2.0**-8), 0.008 + 2.5 / 256),
        (wobbling(2.0**-6), 0.008 + 2.5 / 64),
        (wobbling(0.018), 0.008 + 2.5 * 0.018),
        (wobbling(0.0195), 0.055),
        (wobbling(0.25), 0.055),
        (at_speed(0.5, samples=2), 0.055),  # nothing is known of the roughness
        (at_speed(0.5, samples=1), 0.055),
    ],
)
def test_how_close_depends_on_how_rough_it_was(places: list[Place], close: float, sign: int) -> None:
    def candidate() -> Candidate:
        return candidates(places, 0)[0]

    there = candidate()
    there.wait(1.0)
    expected = position(there.predict())
    assert met_after_one(candidate(), expected + sign * (close - 1e-9))
    assert not met_after_one(candidate(), expected + sign * (close + 1e-9))


def curve_places(bends: list[float], speed: float = 2.0) -> list[Place]:
    here, places = 0.0, []
    for bend in [0.0, 0.0, *bends]:
        places.append(place(here))
        speed += bend if len(places) > 1 else 0.0
        here += speed
    return [*places, place(here)][1:]


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("bends", "mean"),
    [
        ([0.0, 0.0, 0.0], None),
        ([0.125, 0.125, 0.125], 0.125),
        ([0.0, 0.125], 0.0625),  # mean 1/16, rough 1/16
        ([-0.0625, 0.1875], 0.0625),  # mean 1/16, rough 1/8: exactly half of it
        ([-0.0625, 0.1875 - 2**-30], None),
        ([-0.0625 + 2**-30, 0.1875], 0.0625 + 2**-31),
        ([0.125, -0.125], None),
    ],
)
def test_an_acceleration_is_carried_on_as_well(bends: list[float], mean: float | None, sign: int) -> None:
    bends = [sign * bend for bend in bends]
    places = curve_places(bends)
    made = candidates(places, 0)
    if mean is not None and abs(mean) * 2 == max(abs(bend - sum(bends) / len(bends)) for bend in bends):
        mean = None  # just half of the roughness is not enough
    assert len(made) == (1 if mean is None else 2)
    predicted = []
    for candidate in made:
        candidate.wait(1.0)
        predicted.append(position(candidate.predict()))
    step = position_of(places[-1]) - position_of(places[-2])
    wanted = [position_of(places[-1]) + step]
    if mean is not None:
        wanted.append(wanted[0] + sign * mean)
    assert predicted == wanted


def position_of(one: Place) -> float:
    return one.cycles + one.phase


@pytest.mark.parametrize("doubted", [0, 1, 2, 3])
def test_the_last_places_are_left_out_and_waited_for(doubted: int) -> None:
    places = [place(5.25 * k) for k in range(4)] + [place(99.5, 2.0), place(98.0, 1.5), place(7.0)]
    trusted = places[: len(places) - doubted]
    (first, *_) = candidates(places, doubted)
    assert first.gap == sum([1.0, 1.5, 2.0][:doubted])
    assert position(first.last) == position_of(trusted[-1])


def test_accelerations_are_those_of_places_any_time_apart() -> None:
    # 0.25 cycle per interval, then 0.5 (two intervals later: 0.125 per interval squared), then 0.375
    places = [place(1.0), place(1.25), place(2.25, 2.0), place(2.625)]
    made = candidates(places, 0)
    assert len(made) == 1, "+0.125 and -0.125 are no acceleration"
    assert met_after_one(made[0], 2.625 + 0.375 + 0.0549)
    places = [place(1.0), place(1.25), place(2.25, 2.0), place(2.875)]
    made = candidates(places, 0)
    assert len(made) == 2
    made[1].wait(1.0)
    assert position(made[1].predict()) == 2.875 + 0.625 + 0.125


@pytest.mark.parametrize("samples", [1, 2])
def test_too_few_places_show_no_acceleration(samples: int) -> None:
    (only,) = candidates(at_speed(0.25, samples=samples), 0)
    only.wait(1.0)
    assert position(only.predict()) == 0.25 * 2 * (samples - 1)


@pytest.mark.parametrize("gap", [1, 3])
def test_the_phase_is_as_exact_at_any_speed(gap: int) -> None:
    fast = 2**44
    candidate = Candidate([Place(fast * k, 0.25 * k, 1.0) for k in range(3)], 0.0, CLOSE)
    candidate.wait(gap)
    assert candidate.meet((0.5 + 0.25 * gap) % 1.0)
    candidate.wait(1.0)
    ahead = 0.5 + 0.25 * (gap + 1)
    assert candidate.predict()[:2] == (fast * (3 + gap) + math.floor(ahead), ahead % 1.0)


@given(st.floats(-200, 200), st.floats(-0.3, 0.3), st.integers(1, 6), st.integers(0, 3))
def test_on_ideal_curves_a_candidate_meets_what_follows(
    speed: float, acceleration: float, gap: int, doubted: int
) -> None:
    curve = Curve(speed, acceleration)
    places = [place(curve(k)) for k in range(-6, 1)]
    made = candidates(places, doubted)
    gap_positions = [curve(gap + k) for k in range(3)]
    for candidate in made:
        candidate.wait(gap - 1.0)
    for there in gap_positions:
        for candidate in made:
            candidate.wait(1.0)
        made = [candidate for candidate in made if candidate.meet(there % 1.0)]
    best = max(made, key=lambda candidate: candidate.confirmed)
    assert best.confirmed == 3
    assert position(best.last) == pytest.approx(gap_positions[-1], abs=1e-6)
