"""The reference and the zero pulse: what it forgets and when, its instant, its wrap at the revolution."""

import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import example, given, strategies as st
from witness_kit import Machine, flags, moving

from canfb import Sample, Track
from canfb.objects import LossCause, StatusBit
from canfb.signal.limits import Declared
from canfb.signal.supervision import COASTING, LOST, VALID
from canfb.signal.witness.reference import Reference, pulse_between
from canfb.signal.witness.witness import CoarseTrack, Pair
from canfb.signal.witness.zero_pulse import Pulse, PulseVerdict, ZeroPulse
from folding import each

N = 2500


@each("acceleration", [-3.0, -0.5, 0.0, 1.0, 3.0])
@each("elapsed", [0.5, 1.0, 2.0])
@each("place", [0.0, 0.2, 0.5, 0.9])
def test_a_pulse_between_two_samples_is_where_the_machine_was(
    acceleration: float, elapsed: float, place: float
) -> None:
    def position(time: float) -> float:
        return 7.3 + 20.0 * time + acceleration * time * time / 2.0

    tracks = [Track(math.floor(p), p % 1.0, 0.0, True) for p in (position(0.0), position(elapsed))]
    pulse = pulse_between(tracks[0], tracks[1], place, 100.0, elapsed, acceleration)
    assert pulse.cycles + pulse.phase == pytest.approx(position(place * elapsed), abs=1e-9)
    assert pulse.time == pytest.approx(100.0 - elapsed * (1.0 - place))


class Noted:
    """A recovery that notes what it is told."""

    def __init__(self, lost: bool) -> None:
        self.lost, self.declared = lost, Declared()
        self.on_lost: Callable[[], None] = lambda: None
        self.on_speed: Callable[[], None] = lambda: None
        self.told: list[tuple[int, int]] = []
        self.confirmed = 0

    def found(self, jump: int, missing: int) -> None:
        self.told.append((jump, missing))

    def confirm_count(self) -> None:
        self.lost = False
        self.confirmed += 1

    def lose(self, cause: LossCause) -> None:
        self.lost = True
        self.on_lost()


def reference(recovery: Noted, n: int = N) -> Reference:
    return Reference(recovery, CoarseTrack(n, 2048, 1 / 32), ZeroPulse(n))  # type: ignore[arg-type]


def track(position: float) -> Track:
    cycles = math.floor(position)
    return Track(cycles, position - cycles, 0.0, True)


def passed(
    made: Reference, before: float, after: float, place: float, bits: int, time: float = 1.0, **rest: Any
) -> tuple[int, int]:
    """What the chain makes of a sample with a zero pulse, one interval after the one before."""
    edge = pulse_between(track(before), track(after), place, time, 1.0, 0.0)
    return made.apply(Sample(1.0, 0.0, zero_pulse=place, **rest), track(after), bits, edge, time, True)


def pulse(made: Reference, speed: float, time: float) -> tuple[int, int]:
    """A pulse at this time in the middle between two samples, counted with this speed."""
    end = time + 0.5
    return passed(made, speed * (end - 1.0), speed * end, 0.5, LOST, end)


def passes_at(made: Reference, position: float, bits: int, **coarse: Any) -> tuple[int, int]:
    """A pulse in the middle between two samples, the second one at ``position + 0.1``."""
    return passed(made, position - 0.1, position + 0.1, 0.5, bits, **coarse)


@each("not_taken, itself", [(None, False), (1, False), (2, False), (1, True), (2, True)])
def test_a_search_begins_anew_at_a_sample_that_was_not_taken(not_taken: int | None, itself: bool) -> None:
    """At rest samples must span five intervals; each is the second of two, the first has no coarse track."""
    made, sample = reference(Noted(lost=False)), Sample(1.0, 0.0, coarse_sine=1500.0, coarse_cosine=0.0)
    for number in range(7):
        bad = number == not_taken
        made.passed(itself or not bad)
        bits, _ = made.apply(sample, track(3.0), VALID, None, 2.0 * number, not (bad and itself))
        assert bool(bits & VALID) == (number >= (4 if not_taken is None else not_taken + 5) - 1)


@each("counted, later, told", [
    # At a whole number of intervals in a revolution the pulses come the same whichever way it turns.
    (497.0, N / 500.0, []), (-1253.0, N / 1250.0, []), (496.3, N / 499.3, [(0, 3)]),
    (0.3, 0.0, []), (0.3, 0.5, []), (0.3, 0.99, []),  # within an interval
    (-4.0, 10.3, [(0, 4)]), (30.0, 10.3, [(0, -30)]),  # the same one twice: the machine came back
])  # fmt: skip
def test_what_two_pulses_tell_of_the_speed(counted: float, later: float, told: list[tuple[int, int]]) -> None:
    recovery = Noted(lost=True)
    made = reference(recovery)
    pulse(made, counted, 100.0)
    pulse(made, counted, 100.0 + later)
    assert recovery.told == told


def test_a_missed_sample_ends_what_two_pulses_have_told() -> None:
    recovery, confirmed = Noted(lost=True), []
    made = reference(recovery)
    for turn in range(6):
        if turn == 2:
            made.missed()
        pulse(made, 83.4, 100.0 + turn * N / 83.4)
        confirmed.append(recovery.confirmed)
    assert confirmed == [0, 0, 0, 0, 0, 1], "of two for the speed and two for the count one may be false"


def test_a_loss_forgets_what_pulses_have_said() -> None:
    recovery = Noted(lost=False)
    made = reference(recovery)
    assert [passes_at(made, place, VALID)[0] for place in (70.5, 300.5)] == [VALID, COASTING]
    made.coarse.disagreeing = 2
    recovery.lose(LossCause.COASTED)
    assert (made.in_doubt, made.coarse.disagreeing) == (False, 0)
    recovery.confirm_count()
    assert passes_at(made, 300.5 + N, VALID) == (VALID, 0)
    assert not made.zero.referenced


def test_two_pulses_say_where_it_is_and_two_more_what_is_wrong() -> None:
    recovery = Noted(lost=False)
    made = reference(recovery)
    assert passes_at(made, 70.5, COASTING) == (COASTING, 0)
    assert passes_at(made, 70.5, VALID) == (VALID, 0)
    assert not made.zero.referenced, "one may be false"
    assert passes_at(made, 70.5, VALID) == (VALID, 0)
    assert not made.zero.referenced, "a false one comes again while the machine rests"
    assert passes_at(made, 70.5 + N, VALID) == (VALID, 0)
    assert made.zero.referenced
    assert passes_at(made, 70.5 - 3 * N + 0.3, VALID) == (VALID, 0)
    assert (made.set_right, recovery.told) == (0, [])
    assert passes_at(made, 73.5, COASTING) == (COASTING, 0)
    assert not made.in_doubt
    assert passes_at(made, 73.5, VALID) == (COASTING, 0)
    assert passes_at(made, 73.5, VALID) == (COASTING, 0), "the same one again settles nothing"
    assert made.in_doubt
    assert (made.set_right, recovery.told) == (0, [])
    assert passes_at(made, 73.5 + 2 * N, VALID) == (COASTING, -3)
    assert (made.set_right, recovery.told, made.in_doubt) == (1, [(-3, 0)], False)


def test_what_is_not_remembered_any_more_was_not_the_first() -> None:
    made = reference(Noted(lost=False))
    for place in (70.5, 300.5, 500.5, 700.5, 900.5):
        passes_at(made, place, VALID)
    assert passes_at(made, 500.5 + N, VALID) == (LOST, 0)


@each("away, refuted", [(0.02, False), (0.2, True), (-0.4, True)])
def test_a_pulse_far_from_where_the_coarse_track_is_was_false(away: float, refuted: bool) -> None:
    made = reference(Noted(lost=False))
    made.coarse.proven = True
    made.zero.set_place(Pulse(70, 0.5))
    place = 70.5 + round(away * N)
    angle = 2 * math.pi * (place + 0.1) / N
    made.coarse.origin = Pair(*track(place + 0.1)[:2], (place + 0.1) / N % 1.0, 0.0)
    coarse = {"coarse_sine": 1500 * math.sin(angle), "coarse_cosine": 1500 * math.cos(angle)}
    assert passes_at(made, place, VALID, **coarse) == ((VALID if refuted else COASTING), 0)
    assert made.in_doubt != refuted


@each("coarse", [{}, {"coarse_sine": 0.0, "coarse_cosine": 1.0}])
def test_a_pulse_without_an_angle_does_not_align_the_coarse_track(coarse: dict[str, float]) -> None:
    recovery = Noted(lost=True)
    made = reference(recovery)
    made.range_known = True
    assert passes_at(made, 70.5, LOST, **coarse) == (LOST, 0)
    assert recovery.confirmed == 1
    assert made.coarse.origin is None
    assert not made.zero.referenced
    assert passes_at(made, 70.5 + N, VALID) == (VALID, 0)
    assert made.zero.error_cycles(Pulse(70, 0.5)) == 0
    assert made.zero.error_cycles(Pulse(72, 0.5)) == 2


@each("how", ["pulses", "sample times"])
def test_a_count_that_was_lost_is_not_known_by_a_pulse_whose_place_never_was(how: str) -> None:
    """Nor by one whose place is known, before they have told the speed."""
    recovery = Noted(lost=True)
    made = reference(recovery)
    made.had_position = True
    if how == "pulses":
        made.range_known = True
        assert [passes_at(made, 70.5 + turn * N, LOST) for turn in range(3)] == [(LOST, 0)] * 3
        made.zero.set_place(Pulse(72, 0.5))
    else:
        made.zero.set_place(Pulse(72, 0.5))
        assert passes_at(made, 70.5, LOST) == (LOST, 0)
        recovery.on_speed()
    for at in (70.5, 300.5, 70.5 + N):  # one of them is false
        assert passes_at(made, at, LOST) == (LOST, 0)
    assert (recovery.told, recovery.confirmed) == ([], 0)
    assert passes_at(made, 70.5 + 2 * N, LOST) == (LOST, 2)
    assert recovery.confirmed == 1


NOTHING, AGREES = PulseVerdict.NOTHING, PulseVerdict.AGREES
CONTRADICTS, WRONG = PulseVerdict.CONTRADICTS, PulseVerdict.WRONG


def placed(n: int, cycles: int, phase: float) -> ZeroPulse:
    zero = ZeroPulse(n)
    zero.set_place(Pulse(cycles, phase))
    return zero


@given(
    st.integers(1, 100_000),
    st.integers(-200_000, 200_000),
    st.floats(-0.49, 0.49),
    st.integers(-9, 2**40),
    st.integers(-3000, 3000),
    st.floats(0.0, 1.0, exclude_max=True),
)
@example(2500, 1250, 0.0, 0, 17, 0.5)
@example(2500, -1250, 0.0, 1, -1, 0.75)
def test_the_error_put_right_leaves_less_than_half_a_cycle(
    n: int, wrong: int, jitter: float, turns: int, place: int, phase: float
) -> None:
    zero, whole = placed(n, place, phase), math.floor(phase + jitter)
    cycles, seen = place + wrong + turns * n + whole, phase + jitter - whole
    error = zero.error_cycles(Pulse(cycles, seen))
    assert -n / 2 < error <= n / 2
    assert (wrong - error) % n == 0
    assert zero.error_cycles(Pulse(cycles - error, seen)) == 0


def turning(speed: float, n: int) -> Machine:
    """Started from rest, and the zero pulse at cycle 0 of each revolution seen."""
    words = {"position": 0.3, "mark": 0.0, "cycles_per_revolution": n, "coast_samples": 5}
    made = moving(speed, int(3 * n / abs(speed)) + 5, **words)
    assert made.chain.reference.zero.referenced
    return made


@each("n", [7, 10, 2500])
@each("speed", [0.37, -0.37, 1.3, -2.4])
@each("error", [1, -1, 2, -3])
def test_a_wrong_count_is_set_right_at_the_pulse_in_both_directions(n: int, speed: float, error: int) -> None:
    made = turning(speed, n) if n < 100 else turning(30 * speed, n)
    good = made.step()
    offset = made.error(good)
    made.chain.stages.estimator.found(error, 0)
    wrong = []
    while (got := made.step()).valid:
        wrong.append(got)
        assert len(wrong) < n / abs(made.speed) + 2, "a pulse comes once per revolution"
    assert flags(got) == StatusBit.COASTING | StatusBit.REFERENCED
    assert got.jump_cycles == 0, "it may be false"
    doubted = 1
    while not (got := made.step()).jump_cycles:
        doubted += 1
        assert flags(got) == StatusBit.COASTING | StatusBit.REFERENCED
        assert doubted < n / abs(made.speed) + 2
    assert got.jump_cycles == -error
    assert flags(got) == StatusBit.COASTING | StatusBit.REFERENCED
    after = made.step()
    assert after.valid
    assert after.jump_cycles == 0
    assert made.error(after) == pytest.approx(offset, abs=0.03)
    assert made.chain.reference.set_right == 1


@pytest.mark.parametrize("n", [7, 10, 2500])
@pytest.mark.parametrize("when", [0.1, 0.3, 0.5, 0.8])
@pytest.mark.parametrize("first", ["false", "true"])
def test_one_false_pulse_never_makes_a_position_valid_and_wrong(n: int, when: float, first: str) -> None:
    """At any time after the start: as the first one, between the first two, and later."""
    for turns in (0, 1, 2, 3) if first == "true" else (0,):
        made = Machine(position=0.3, mark=0.0, cycles_per_revolution=n, coast_samples=5)
        speed = 1.3 if n < 100 else 39.0
        good = made.step()
        offset = made.error(good)
        false = (turns + when) * n if first == "true" else 0.3 * n
        seen, pulses, sent = [], 0, False
        while made.position < 7 * n:
            made.speed = min(speed, made.speed + 0.1)
            sample = made.sample()
            if not sent and made.position > false and sample.zero_pulse is None and made.speed > 0.2:
                sample, sent = sample._replace(zero_pulse=0.5), True
            got = made.chain.step(sample)
            seen.append(got)
            pulses += sample.zero_pulse is not None
            assert not got.valid or abs(made.error(got) - offset) < 0.25
            assert got.jump_cycles == 0, "the position was right all the time"
        assert sent
        assert flags(seen[-1]) == StatusBit.VALID | StatusBit.REFERENCED


def test_a_restart_forgets_the_place_and_a_pause_does_not() -> None:
    made = turning(0.3, 10)
    made.chain.resume()
    assert flags(made.step()) == StatusBit.VALID | StatusBit.REFERENCED
    made.chain.restart(3)  # and so every pulse comes at another count
    got = [made.step() for _ in range(100)]
    assert flags(got[0]) == StatusBit.VALID
    assert flags(got[-1]) == StatusBit.VALID | StatusBit.REFERENCED
    assert not any(one.jump_cycles for one in got)


@each("late", [0, 1])
def test_a_pulse_in_a_bad_sample_or_behind_it_is_not_believed_and_the_next_two_are(late: int) -> None:
    made = turning(1.3, 10)
    made.chain.stages.estimator.found(2, 0)
    samples = [made.sample() for _ in range(9)]
    at_pulse = next(k for k, sample in enumerate(samples) if k and sample.zero_pulse is not None)
    for k, sample in enumerate(samples[: at_pulse + 1]):
        bad = k == at_pulse - late
        got = made.chain.step(sample._replace(sine=0.0, cosine=0.0) if bad else sample)
        assert got.jump_cycles == 0
        if bad:
            assert flags(got) == StatusBit.AMPLITUDE | StatusBit.COASTING | StatusBit.REFERENCED
    for sample in samples[at_pulse + 1 :]:
        assert made.chain.step(sample).jump_cycles == 0
    for _ in range(2):
        while (sample := made.sample()).zero_pulse is None:
            made.chain.step(sample)
        jump = made.chain.step(sample).jump_cycles
    assert jump == -2


def test_each_direction_has_a_place_of_its_own() -> None:
    zero = ZeroPulse(100)
    assert [zero.weigh(Pulse(turn * 100, 0.5)) for turn in range(2)] == [NOTHING, AGREES]
    assert zero.weigh(Pulse(101, 0.5, -1)) is NOTHING
    assert not zero.knows(Pulse(101, 0.5, -1)), "a lost count is not set by it"
    assert zero.weigh(Pulse(202, 0.5, -1)) is CONTRADICTS
    assert zero.weigh(Pulse(302, 0.5, -1)) is CONTRADICTS, "twice, and yet it is not known by how many"
    assert zero.weigh(Pulse(300, 0.6)) is AGREES
    assert [zero.weigh(Pulse(turn * 100 + 1, 0.5, -1)) for turn in (3, 2)] == [NOTHING, AGREES]
    assert zero.weigh(Pulse(102, 0.5, -1)) is CONTRADICTS
    assert zero.weigh(Pulse(2, 0.5, -1)) is WRONG
