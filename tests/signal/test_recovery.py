"""Coasting, confirmation, loss, and how a chain goes on after each."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from supervision_kit import DEAD, Drive, above, at, below, flags, has

from canfb.objects import StatusBit
from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import ChainConfig
from canfb.signal.recovery.recovery import Recovery
from canfb.signal.sample import Sample
from canfb.signal.tracker import Track, Tracker
from folding import each

VALID, COASTING, LOST, RESIDUAL = 1, 2, 4, 8
SPEEDS = [0.0, 0.3, -0.3, 5.0, 41.3, -83.37]
LONGEST_CONFIRMATION = 8


def position(track: Track) -> float:
    return track.cycles + track.phase


class Following:
    """A recovery on exact phases of a machine at constant speed; the truth is ``position``."""

    def __init__(self, speed: float, coast_samples: int = 3, samples: int = 12) -> None:
        self.recovery = Recovery(Tracker(1 / 3), coast_samples)
        self.speed = self.position = 0.0
        self.good()
        while self.speed != speed:
            self.speed += max(-0.25, min(0.25, speed - self.speed))
            assert self.good()[1] == VALID
        for _ in range(samples):
            assert self.good()[1] == VALID

    def good(self, off: float = 0.0, elapsed: float = 1.0) -> tuple[Track, int]:
        self.position += self.speed * elapsed
        return self.recovery.good((self.position + off) % 1.0, elapsed)

    def bad(self, elapsed: float = 1.0) -> tuple[Track, int]:
        self.position += self.speed * elapsed
        return self.recovery.bad(elapsed)

    def until_valid(self) -> int:
        """Good samples until the position is valid again, and right."""
        for samples in range(1, LONGEST_CONFIRMATION + 2):
            track, bits = self.good()
            assert position(track) == pytest.approx(self.position, abs=1e-6)
            if bits == VALID:
                return samples
            assert bits == COASTING
        raise AssertionError("never valid")


@each("coast", [0, 1, 3, 255])
@each("speed", SPEEDS)
def test_it_coasts_over_so_many_samples_and_not_one_more(speed: float, coast: int) -> None:
    machine = Following(speed, coast)
    for _ in range(coast):
        track, bits = machine.bad()
        assert bits == COASTING
        assert (track.residual, track.ok) == (0.5, False)
        assert position(track) == pytest.approx(machine.position, abs=1e-6)
        assert not machine.recovery.lost
    assert machine.bad()[1] == LOST
    assert machine.recovery.lost
    for _ in range(30):
        track, bits = machine.good()
        assert bits & ~RESIDUAL == LOST
    assert machine.bad()[1] == LOST


@pytest.mark.parametrize("coast", [1, 3, 8])
@pytest.mark.parametrize("speed", SPEEDS)
def test_within_them_a_few_good_samples_confirm_the_position(speed: float, coast: int) -> None:
    machine = Following(speed, coast)
    for _ in range(coast):
        machine.bad()
    # At rest, or at a constant speed, four samples are proof.
    assert machine.until_valid() == 4
    for _ in range(20):
        track, bits = machine.good()
        assert bits == VALID
        assert position(track) == pytest.approx(machine.position, abs=1e-6)


@pytest.mark.parametrize("speed", [0.0, 0.3, 41.3])
def test_after_a_long_gap_nobody_knows(speed: float) -> None:
    machine = Following(speed, 255)
    for _ in range(30):
        assert machine.bad()[1] == COASTING
    # An acceleration of 1/200 cycle per interval squared, unseen in the gap, is worth a cycle.
    assert [machine.good()[1] for _ in range(5)] == [COASTING] * 3 + [LOST] * 2


@pytest.mark.parametrize("speed", [0.3, 5.25, -41.3])
@pytest.mark.parametrize("late", [1, 2, 3])
def test_a_bad_sample_among_the_confirming_ones_begins_a_new_count_of_them(speed: float, late: int) -> None:
    machine = Following(speed)
    machine.bad()
    for _ in range(late):
        assert machine.good()[1] == COASTING
    assert machine.bad()[1] == COASTING
    assert machine.until_valid() == 4


def test_good_samples_that_never_come_in_a_row_do_not_coast_for_ever() -> None:
    machine = Following(5.25)
    bits = []
    for _ in range(20):
        bits += [machine.bad()[1], machine.good()[1]]
    assert bits[:34] == [COASTING] * 34
    assert bits[-2:] == [LOST] * 2


@pytest.mark.parametrize("elapsed", [1.0, 2.0, 3.0, 4.0])
@pytest.mark.parametrize("coast", [0, 1, 3])
def test_a_gap_in_one_piece_is_as_long(elapsed: float, coast: int) -> None:
    machine = Following(20.4, coast)
    track, bits = machine.bad(elapsed)
    assert bits == (COASTING if elapsed <= coast else LOST)
    if bits == COASTING:
        assert position(track) == pytest.approx(machine.position, abs=1e-6)


@pytest.mark.parametrize(
    ("elapsed", "missed"), [(1.0, 0), (1.4, 0), (1.6, 1), (2.0, 1), (3.0, 2), (4.0, 3), (5.0, 4)]
)
@pytest.mark.parametrize("speed", [0.3, -20.4])
def test_a_late_sample_has_passed_over_missed_ones(speed: float, elapsed: float, missed: int) -> None:
    machine = Following(speed)
    track, bits = machine.good(elapsed=elapsed)
    assert bits == (VALID if missed == 0 else COASTING if missed <= 3 else LOST)
    if missed == 0:
        assert machine.good()[1] == VALID
    elif missed <= 3:
        assert position(track) == pytest.approx(machine.position, abs=1e-6)
        assert machine.until_valid() == 3


@pytest.mark.parametrize("elapsed", [0.9, 1.1, 0.6, 1.4])
def test_samples_at_uneven_times_are_followed(elapsed: float) -> None:
    machine = Following(20.4)
    for k in range(50):
        track, bits = machine.good(elapsed=elapsed if k % 2 else 2.0 - elapsed)
        assert bits in (VALID, COASTING)
        assert position(track) == pytest.approx(machine.position, abs=1e-6)


@each("off", [0.34, -0.34, 0.45, 0.5])
@each("speed", SPEEDS)
def test_one_sample_over_the_residual_limit_is_told_and_costs_nothing(speed: float, off: float) -> None:
    machine = Following(speed)
    track, bits = machine.good(off)
    assert bits == COASTING | RESIDUAL
    assert track.residual == pytest.approx(abs(off), abs=1e-6)
    assert machine.until_valid() == 4


@each("off", [0.1, 0.2, 0.3, -0.3])
@each("length", [1, 2, 3])
@each("speed", [0.0, 5.25, -41.3])
def test_a_glitch_below_the_limit_is_forgotten_too(speed: float, length: int, off: float) -> None:
    machine = Following(speed)
    for k in range(length):
        machine.good(off + 0.001 * k)
    for _ in range(20):
        track, bits = machine.good()
    assert bits == VALID
    assert position(track) == pytest.approx(machine.position, abs=1e-6)


def test_an_acceleration_beyond_the_limit_is_flagged_and_followed_as_eq_9_does() -> None:
    machine = Following(5.0)
    for _ in range(3):
        machine.speed += 0.4
        track, bits = machine.good()
        assert bits & COASTING
        assert position(track) == pytest.approx(machine.position, abs=1e-6)
        assert not bits & VALID


def test_before_the_first_sample_there_is_nothing_to_lose() -> None:
    recovery = Recovery(Tracker(1 / 3), 0)
    for _ in range(5):
        assert recovery.bad(1.0) == ((0, 0.0, 0.5, False), 0)
    assert recovery.good(0.3, 7.0) == ((0, 0.3, 0.0, True), VALID)
    recovery.lose()
    recovery.tracker.restart()
    assert recovery.bad(1.0)[1] == LOST


def test_a_restart_begins_at_standstill_with_this_count() -> None:
    machine = Following(41.3)
    for _ in range(9):
        machine.bad()
    assert machine.recovery.lost
    machine.recovery.restart(77)
    assert machine.recovery.lost is False
    assert machine.recovery.good(0.25, 1.0) == ((77, 0.25, 0.0, True), VALID)
    assert machine.recovery.good(0.0, 1.0) == ((77, 0.0, 0.25, True), VALID)
    machine.recovery.restart()
    assert machine.recovery.good(0.9, 1.0)[0].cycles == 0


def test_a_resume_goes_on_at_standstill_within_half_a_cycle() -> None:
    machine = Following(41.3)
    last = machine.position
    machine.recovery.resume()
    track, bits = machine.recovery.good((last + 0.3) % 1.0, 1.0)
    assert bits == VALID
    assert position(track) == pytest.approx(last + 0.3)
    machine.recovery.resume()
    track, bits = machine.recovery.bad(1.0)
    assert bits == COASTING
    assert position(track) == pytest.approx(last + 0.3), "it stands"


def test_nothing_from_before_a_restart_is_carried_on() -> None:
    machine = Following(41.3)
    machine.recovery.restart(5)
    assert machine.recovery.good(0.25, 1.0)[1] == VALID
    track, bits = machine.recovery.bad(1.0)
    assert (position(track), bits) == (5.25, COASTING)


def test_the_speed_from_before_a_pause_is_no_way_through_a_gap() -> None:
    machine = Following(5.0, coast_samples=20)
    machine.recovery.resume()
    machine.speed = 0.0
    machine.bad()
    assert machine.until_valid() == 4


def test_found_ends_a_doubt() -> None:
    machine = Following(5.25)
    machine.bad()
    machine.recovery.found(7, 0)
    machine.position += 7
    assert not machine.recovery.in_doubt
    track, bits = machine.good()
    assert bits == VALID
    assert position(track) == pytest.approx(machine.position, abs=1e-6)


@pytest.mark.parametrize("state", ["lost", "coasting", "never started"])
def test_a_resume_without_a_sure_position_begins_at_nought(state: str) -> None:
    machine = Following(5.25)
    if state == "never started":
        machine.recovery = Recovery(Tracker(1 / 3), 3)
    for _ in range({"lost": 4, "coasting": 2, "never started": 0}[state]):
        machine.bad()
    machine.recovery.resume()
    assert not machine.recovery.lost
    assert not machine.recovery.in_doubt
    assert machine.recovery.good(0.5, 1.0) == ((0, 0.5, 0.0, True), VALID)


def test_lost_from_outside() -> None:
    machine = Following(5.25)
    assert not machine.recovery.in_doubt
    machine.bad()
    assert machine.recovery.in_doubt
    machine.recovery.lose()
    assert (machine.recovery.lost, machine.recovery.in_doubt) == (True, False)
    track, bits = machine.good()
    assert bits == LOST
    assert position(track) == pytest.approx(machine.position), "eq. 9 runs on"
    assert machine.recovery.least_speed() == 0.0


@pytest.mark.parametrize("speed", [0.0, 5.0, 5.25, -41.3])
def test_found_shifts_the_count_and_a_fault_just_after_it_does_no_harm(speed: float) -> None:
    machine = Following(speed)
    machine.recovery.found(7, 0)
    machine.position += 7
    track, bits = machine.bad()
    assert bits == COASTING
    assert position(track) == pytest.approx(machine.position, abs=1e-6)
    machine.until_valid()


@pytest.mark.parametrize("missing", [1, -1, 83, -125])
def test_found_sets_the_speed_right_as_well(missing: int) -> None:
    machine = Following(0.25)
    machine.recovery.found(0, missing)
    machine.speed += missing
    for _ in range(10):
        track, bits = machine.good()
        assert bits == VALID
        assert position(track) == pytest.approx(machine.position, abs=1e-6)


def test_vouched_for_it_is_valid_with_the_next_sample_and_can_coast() -> None:
    machine = Following(5.25)
    machine.recovery.lose()
    machine.good()
    machine.recovery.vouch()
    assert machine.recovery.lost is False
    track, bits = machine.bad()
    assert bits == COASTING
    assert position(track) == pytest.approx(machine.position, abs=1e-6)
    machine.until_valid()
    machine.recovery.lose()
    machine.recovery.vouch()
    assert machine.good()[1] == VALID


def test_while_lost_the_residual_is_still_told() -> None:
    machine = Following(5.25)
    machine.recovery.lose()
    assert machine.good()[1] == LOST
    assert machine.good(0.4)[1] == LOST | RESIDUAL


@pytest.mark.parametrize("sign", [1, -1])
def test_two_ways_through_the_gap_are_no_way(sign: int) -> None:
    # At its limit an acceleration of four samples is more than a cycle per interval: with it and without it
    # the phases are the same.
    machine = Following(5.0 * sign, coast_samples=20)
    for _ in range(4):
        machine.speed += 0.33 * sign
        assert machine.good()[1] == VALID
    machine.bad()
    machine.bad()
    seen = [machine.good()[1] for _ in range(20)]
    assert seen == [COASTING] * 3 + [LOST] * 17


@pytest.mark.parametrize("coast", [3, 20, 255])
def test_random_phases_are_never_called_valid(coast: int) -> None:
    machine = Following(5.25, coast)
    golden = (math.sqrt(5) - 1) / 2
    bits = [machine.recovery.good(k * k * golden % 1.0, 1.0)[1] for k in range(1, 400)]
    first = next(k for k, got in enumerate(bits) if not got & VALID)
    assert first < 4
    assert not any(got & VALID for got in bits[first:])
    assert bits[-1] & LOST


@pytest.mark.parametrize(
    ("steps", "least"),
    [
        ([5.0, 5.0, 5.0, 5.0], 5.0),
        ([0.25, 5.0, 5.1, 5.2, 5.3], 5.0),
        ([5.0, 5.0, 5.0, 0.25], 0.25),
        ([0.25, 5.0, 5.0, 5.0], 0.25),
        ([0.125, 0.25, -0.0625, 0.25], -0.0625),
        ([-3.0, -3.25], -3.0),
        ([], 0.0),
    ],
)
def test_the_least_speed_of_the_last_four(steps: list[float], least: float) -> None:
    recovery = Recovery(Tracker(0.5), 3)
    recovery.followed([0], [0.5])
    here = 0.5
    for step in steps:
        here += step
        recovery.followed([math.floor(here)], [here % 1.0])
    assert recovery.least_speed() == pytest.approx(least)
    recovery.lose()
    recovery.followed([9, 99], [0.0, 0.0])
    assert recovery.least_speed() == 0.0


def test_the_least_speed_counts_intervals() -> None:
    machine = Following(5.25)
    machine.good(elapsed=0.5)
    machine.good(elapsed=0.5)
    assert machine.recovery.least_speed() == pytest.approx(5.25)


def at_steps(recovery: Recovery, steps: list[float], start: float = 0.5) -> float:
    """Samples this far apart follow each other; where the last one is."""
    for step in [0.0, *steps]:
        start += step
        recovery.followed([math.floor(start)], [start % 1.0])
    return start


some_steps = st.lists(st.sampled_from([0.0, 0.25, -0.25, 5.0, 5.25, -83.5, 1000.0]), max_size=12)


@given(some_steps, some_steps)
@example([0.25, 5.0, 5.0, 5.0, 5.0], [5.0])
@example([0.25, 5.0, 5.0, 5.0], [5.0])
@example([], [5.0, 5.0, 0.25, 5.0, 5.0, 5.0, 5.0, 5.0])
def test_the_least_speeds_of_a_run_are_those_one_by_one(before: list[float], run: list[float]) -> None:
    array, single = Recovery(Tracker(0.5), 3), Recovery(Tracker(0.5), 3)
    here = at_steps(array, before)
    at_steps(single, before)
    positions = list(itertools.accumulate(run, initial=here))[1:]
    cycles, phases = [math.floor(x) for x in positions], [x % 1.0 for x in positions]
    wanted = []
    for count, phase in zip(cycles, phases, strict=True):
        wanted.append(abs(single.least_speed()))
        single.followed([count], [phase])
    got = array.least_speeds(np.array(cycles, np.int64), np.array(phases))
    assert got.tolist() == wanted
    array.lose()
    assert array.least_speeds(np.array(cycles, np.int64), np.array(phases)).tolist() == [0.0] * len(run)


def test_the_least_speeds_with_uneven_intervals_and_before_any_sample() -> None:
    recovery = Recovery(Tracker(0.5), 3)
    assert recovery.least_speeds(np.array([9, 18]), np.array([0.0, 0.5])).tolist() == [0.0, 0.0]
    machine = Following(5.25)
    for elapsed in (0.5, 1.25, 0.75, 1.0):
        machine.good(elapsed=elapsed)
    here = machine.position + 5.5
    got = machine.recovery.least_speeds(np.array([math.floor(here)] * 3), np.array([here % 1.0] * 3))
    assert got[:2] == pytest.approx([5.25, 5.25])
    assert got[2] == 0.0


def test_a_glitch_just_after_the_start_is_forgotten_as_well() -> None:
    machine = Following(0.25, samples=0)
    machine.recovery.restart()
    machine.position = 0.0
    for off in (0.0, 0.0, 0.2):
        assert machine.good(off)[1] == VALID
    assert machine.good()[1] == COASTING | RESIDUAL
    for _ in range(LONGEST_CONFIRMATION):
        track, bits = machine.good()
    assert bits == VALID
    assert position(track) == pytest.approx(machine.position, abs=1e-6)


def test_lost_at_once_tells_the_residual_of_eq_9() -> None:
    assert Following(5.25, coast_samples=0).good(0.4)[1] == LOST | RESIDUAL


@pytest.mark.parametrize("coast", [0, 1, 3, 255])
def test_half_an_interval_more_than_the_samples_to_coast_is_too_long(coast: int) -> None:
    for gap, bits in ((below(coast + 0.5), COASTING), (coast + 0.5, LOST), (above(coast + 0.5), LOST)):
        assert Following(5.25, coast).bad(gap)[1] == bits


def test_as_many_counts_as_phases_are_wanted() -> None:
    with pytest.raises(ValueError, match="shorter"):
        Recovery(Tracker(0.5), 3).followed([1, 2], [0.5])


@pytest.mark.parametrize(("off", "near"), [(0.05, True), (-0.05, True), (0.09, False), (-0.3, False)])
def test_a_sample_that_is_not_where_it_was_expected_is_told(off: float, near: bool) -> None:
    machine = Following(5.0)
    machine.bad()
    assert machine.good(off)[1] == (COASTING if near else COASTING | RESIDUAL)


@pytest.mark.parametrize("coast", [0, 1, 3, 255])
@pytest.mark.parametrize("bad", ["dead", "missed", "invalid"])
def test_in_the_chain_lost_is_said_in_the_same_sample(bad: str, coast: int) -> None:
    drive = Drive(5.5, coast_samples=coast)
    make = {"dead": drive.spoil, "missed": drive.miss, "invalid": lambda: drive.step(invalid=True)}[bad]
    got = [make() for _ in range(coast + 3)]
    assert has(got, StatusBit.COASTING) == [True] * coast + [False] * 3
    assert has(got, StatusBit.LOST) == [False] * coast + [True] * 3
    assert not any(has(got, StatusBit.VALID))
    assert drive.chain.lost


def test_a_new_number_of_samples_to_coast_holds_at_once() -> None:
    drive = Drive(5.5, coast_samples=3)
    for _ in range(3):
        drive.spoil()
    drive.chain.set_limits(ChainConfig(coast_samples=5).chain_limits)
    assert has([drive.spoil() for _ in range(3)], StatusBit.LOST) == [False, False, True]


def test_a_chain_that_was_lost_goes_on_after_restart_and_resume() -> None:
    for begin, count in ((lambda chain: chain.restart(5), 5), (lambda chain: chain.resume(), 0)):
        chain = SignalChain(ChainConfig(coast_samples=0))
        chain.step(at(0.25))
        assert flags(chain.step(DEAD)) == StatusBit.LOST | StatusBit.AMPLITUDE
        assert flags(chain.step(at(0.25))) == StatusBit.LOST
        begin(chain)
        got = chain.step(at(0.25))
        assert flags(got) == StatusBit.VALID
        assert got.cycles == count
        assert got.jump_cycles == 0


def test_a_zero_vector_is_no_phase_whatever_the_limits() -> None:
    chain = SignalChain(ChainConfig(amplitude_low_counts=0))
    for _ in range(5):
        chain.step(Sample(0.0, 1000.0))
    assert flags(chain.step(DEAD)) == StatusBit.COASTING
