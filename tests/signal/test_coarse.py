"""The coarse track: its limit and hysteresis, the search for lost ranges of speed, lost counts set right."""

import math
import random

import numpy as np
import pytest
from hypothesis import example, given, strategies as st
from witness_kit import Machine, above, at, below, flags, has, moving

from canfb import Feedback, StatusBit
from canfb.signal.witness.witness import CoarseTrack, Pair
from folding import each

N = 4096  # with powers of two the limits are exact
FULL = 2048


def coarse(limit: float = 0.125, n: int = N, full: int = FULL) -> CoarseTrack:
    return CoarseTrack(n, full, limit)


def pair(track: CoarseTrack, angle: float, position: float = 0.0, time: float = 0.0) -> Pair:
    cycles = math.floor(position)
    here = track.pair(angle, cycles, position - cycles, time)
    assert here is not None
    return here


def aligned(limit: float = 0.125, angle: float = 0.0, position: float = 0.0) -> CoarseTrack:
    track = coarse(limit)
    track.origin = pair(track, angle, position)
    return track


def fits(track: CoarseTrack, angle: float, position: float = 0.0) -> bool:
    return track.fits(pair(track, angle, position))


def test_the_amplitude_below_which_it_tells_nothing_is_a_tenth_of_the_full_scale() -> None:
    track = coarse(full=1000)
    for sine, cosine in ((100.0, 0.0), (-100.0, 0.0), (0.0, 100.0), (0.0, -100.0), (60.0, 80.0)):
        assert track.angle(sine, cosine) is None
        assert track.angle(below(sine) if sine <= 0 else above(sine), cosine * 1.001 or 1.0) is not None
    for sine, cosine in ((0.0, 0.0), (math.nan, 1000.0), (1000.0, math.nan)):
        assert track.angle(sine, cosine) is None


@given(st.floats(0.0, 1.0))
@example(-1e-300)
def test_the_angle_is_in_revolutions(turn: float) -> None:
    got = coarse().angle(1500 * math.sin(2 * math.pi * turn), 1500 * math.cos(2 * math.pi * turn))
    assert got is not None
    assert 0.0 <= got < 1.0
    assert math.remainder(got - turn, 1.0) == pytest.approx(0.0, abs=1e-15)


@each("turned", [0.0, 0.25, 0.5, 0.9])
@each("turns", [0, -7, 12])
@each("disagreeing, limit", [(0, 0.125), (1, 0.09375), (2, 0.09375)])
@each("away", [0.0, 0.05, 0.093, 0.0945, 0.124, 0.126, 0.3, 0.5, 0.7, 0.874, 0.876, 0.9999])
def test_a_disagreement_is_more_than_the_limit_and_ends_below_three_quarters_of_it(
    turned: float, turns: int, disagreeing: int, limit: float, away: float
) -> None:
    """From anywhere on the revolution, and any number of revolutions away."""
    track = aligned(angle=turned, position=N * turned)
    track.disagreeing = disagreeing
    assert fits(track, (turned + away) % 1.0, N * (turned + turns)) == (min(away, 1.0 - away) <= limit)
    assert fits(track, turned, N * (turned + turns) + N * away) == (min(away, 1.0 - away) <= limit)


def test_the_limit_itself_fits_and_before_it_is_aligned_any_angle() -> None:
    track = aligned()
    assert fits(track, 0.125)
    assert not fits(track, above(0.125))
    assert fits(track, 0.0, N / 8)
    assert not fits(track, 0.0, N / 8 + 0.001)
    assert all(fits(coarse(), angle, 17.3) for angle in (0.0, 0.3, 0.5, 0.9))


def search(
    track: CoarseTrack,
    speed: float,
    missing: float,
    error: float = 0.0,
    elapsed: float = 1.0,
    samples: int = 3000,
) -> tuple[int, int] | None:
    """Samples until the answer, and the answer; ``error`` (revolutions) has one and two waves."""
    for k in range(samples):
        turn = 0.37 + speed * k * elapsed / track.scale.period_cycles
        angle = (turn + error * (math.sin(2 * math.pi * turn) + math.cos(4 * math.pi * turn)) / 2) % 1.0
        here = pair(track, angle, 5.25 + (speed - missing) * k * elapsed, k * elapsed)
        if (found := track.missing_speed(here)) is not None:
            return k + 1, found
    return None


@each("error", [0.0, 0.03, -0.03])
@each("direction", [1, -1])
@each("speed", [0.0, 0.01, 1.0, 3.3, 83.4, 125.0, 1000.0])
@each("missing", [0, 1, -1, 2, -2, 83, -125])
def test_the_range_of_speed_is_found_and_never_a_wrong_one(
    missing: int, speed: float, direction: int, error: float
) -> None:
    found = search(coarse(1 / 32, 2500), direction * speed, missing, error)
    assert found is not None
    assert found[1] == missing


@each("n, full, limit, speed, elapsed, samples",
    [
        # at standstill noise alone decides, twice the error of a pair: 8 n/(pi full) intervals
        (2500, 2048, 1 / 32, 0.0, 1.0, 6),
        (2500, 32768, 1 / 32, 0.0, 1.0, 3),
        (2500, 128, 1 / 32, 0.0, 1.0, 52),
        (25000, 2048, 1 / 32, 0.0, 1.0, 34),
        (2500, 2048, 1 / 32, 0.0, 0.5, 10),
        (2500, 2048, 1 / 32, 0.0, 4.0, 3),
        # in motion its error counts, 4 pi limit of the turn, at most twice the limit: 2 (2 limit + noise) n
        (2500, 2048, 1 / 32, 83.0, 1.0, 318),
        (2500, 2048, 1 / 64, 83.0, 1.0, 162),
        (2500, 2048, 1 / 4, 83.0, 1.0, 2506),
        (2500, 2048, 1 / 128, 1.0, 1.0, 7),
        (2500, 2048, 1 / 64, -1.0, 1.0, 8),
    ],
)  # fmt: skip
def test_how_long_the_search_takes(
    n: int, full: int, limit: float, speed: float, elapsed: float, samples: int
) -> None:
    for missing in (0, 3, -7):
        got = search(CoarseTrack(n, full, limit), speed, missing, elapsed=elapsed, samples=6000)
        assert got == (samples, missing)


@each("slope, found", [(0.2, 0), (-0.2, 0), (0.45, None), (-0.45, None), (0.5, None), (0.8, 1), (-0.8, -1)])
def test_a_slope_between_two_whole_numbers_is_no_answer(slope: float, found: int | None) -> None:
    got = search(coarse(1 / 1024, 2500, 32768), 83.0, slope, samples=60)
    assert (got and got[1]) == found


@pytest.mark.parametrize("away", [(1427.0, -463.0), (0.0, 0.0)], ids=["turned away", "dead"])
def test_three_disagreements_in_a_row_lose_the_position(away: tuple[float, float]) -> None:
    machine = Machine(position=0.25, coarse=0.0, cycles_per_revolution=N, coarse_limit_revolutions=0.125)
    wrong = at(0.25, coarse_sine=away[0], coarse_cosine=away[1])
    assert flags(machine.run(30)[-1]) == StatusBit.VALID
    for _ in range(3):  # two, and an agreement: begins anew each time
        got = [machine.spoil(wrong), machine.spoil(wrong), machine.step()]
        assert has(got, StatusBit.COARSE) == [True, True, False]
        assert has(got, StatusBit.VALID) == [False, False, True]
    got = [machine.spoil(wrong) for _ in range(3)]
    assert has(got, StatusBit.COARSE) == [True] * 3
    assert has(got, StatusBit.LOST) == [False, False, True]
    assert flags(got[2]) == StatusBit.COARSE | StatusBit.LOST
    assert not machine.step().valid


def test_a_restart_forgets_where_the_coarse_track_stands() -> None:
    machine = Machine(position=0.25, coarse=0.0, cycles_per_revolution=N, coarse_limit_revolutions=0.125)
    assert machine.run(30)[-1].valid
    machine.chain.restart()
    machine.position += 0.3 * N
    got = machine.run(30)
    assert not any(has(got, StatusBit.COARSE))
    assert got[-1].valid


def errors(machine: Machine, samples: int) -> list[tuple[Feedback, float]]:
    """Of so many samples, and by how many cycles each position is off."""
    return [(got, machine.error(got)) for got in (machine.step() for _ in range(samples))]


def of_valid(found: list[tuple[Feedback, float]]) -> np.ndarray:
    return np.array([error for got, error in found if got.valid])


@pytest.mark.parametrize(("n", "exact"), [(8, True), (15, True), (17, True), (32, False), (2500, False)])
def test_where_just_one_count_is_within_its_limit_it_sets_the_count_right_alone(n: int, exact: bool) -> None:
    machine = Machine(position=1000.5, coarse=0.0, cycles_per_revolution=n, coarse_limit_revolutions=1 / 32)
    right = of_valid(errors(machine, 60))[-1]
    assert machine.chain.reference.recovered == 0, "at rest it was not wrong"
    for _ in range(4):
        machine.miss()
    assert machine.chain.lost
    found = of_valid(errors(machine, 200))
    assert machine.chain.reference.recovered == 1
    assert bool(len(found)) == exact
    assert machine.chain.lost == (not exact)
    assert found == pytest.approx(right, abs=1e-9)


@each("fault", ["none", "amplitude", "missed", "long gap"])
@each("speed", [0.0, 0.4, 1, -1, 2, -3, 17, -50, 83, -83, 124, -125])
def test_started_on_a_turning_machine(speed: float, fault: str) -> None:
    machine = Machine(speed + (0.13 if speed else 0.0), 1000.5, coarse=0.008)
    assert not len(of_valid(errors(machine, 4)))
    if fault == "amplitude":
        machine.spoil()
    for _ in range({"missed": 1, "long gap": 3}.get(fault, 0)):
        machine.miss()
    after = errors(machine, 1500)
    if fault == "none" and speed != 0.4:  # the first position keeps its count, but for eq. 9 at 0.53
        assert not any(has((got for got, _ in after), StatusBit.LOST))
    found = of_valid(after)
    assert len(found) > 700
    assert np.ptp(found) < 0.03


@pytest.mark.parametrize("seed", [*range(10), 2164, 3390, 3979, 7719, 9420])
def test_samples_that_are_missing_leave_no_wrong_speed_of_a_start(seed: int) -> None:
    draw = random.Random(seed)
    speed = draw.choice([-3, -2, -1, 1, 2, 3]) + draw.uniform(-0.1, 0.1)
    machine = Machine(speed, draw.uniform(0.0, 256.0), coarse=0.0, cycles_per_revolution=256)
    valid = []
    for sample in range(40):
        missing = 0 < sample < 14 and draw.random() < 0.3
        got = draw.choice([machine.miss, machine.spoil])() if missing else machine.step()
        valid += [machine.error(got)] * got.valid
    assert not valid or np.ptp(valid) < 0.1


@pytest.mark.parametrize("seed", [*range(10), 412, 586, 1053, 1950, 5498])
def test_uneven_times_leave_no_wrong_speed_of_a_start(seed: int) -> None:
    draw = random.Random(seed)
    speed = wanted = draw.uniform(-3.5, 3.5)
    machine, late, time, valid = Machine(coarse=0.0, cycles_per_revolution=400), 0.0, 0.0, []
    for _ in range(100):
        wanted = draw.uniform(-3.5, 3.5) if draw.random() < 0.02 else wanted
        speed += max(-0.0175, min(0.0175, wanted - speed))
        before, late = late, draw.uniform(-0.1, 0.1)
        machine.speed, time = speed * (1.0 + late - before), time + 1.0 + late - before
        got = machine.step(time_100ns=round(1e4 * time))
        valid += [machine.error(got)] * got.valid
    assert not valid or np.ptp(valid) < 0.1


@each("outage, speed, every", [(4, 86.4, 1), (30, 86.4, 1), (500, 86.4, 1), (30, 5.3, 2), (30, 5.3, 3)])
def test_a_lost_position_is_set_right_by_coarse_and_pulse(outage: int, speed: float, every: int) -> None:
    machine = moving(83.1, 300, position=1234.56, coarse=0.008, mark=0.0)
    got = machine.step()
    right = machine.error(got)
    assert got.status & StatusBit.REFERENCED
    machine.speed, machine.every = speed, every
    assert [machine.spoil() for _ in range(outage)][-1].status & StatusBit.LOST
    after = errors(machine, 2000)
    assert after[-1][0].valid
    wrong = of_valid(after) - right
    assert np.abs(wrong - np.rint(wrong / machine.n) * machine.n).max() < 0.04
    assert any(got.jump_cycles for got, _ in after)
    jumps = np.flatnonzero(np.abs(np.diff([error for _, error in after])) > 90.0)
    assert all(after[k][0].jump_cycles != 0 for k in jumps), "a jump is reported by the sample before it"
