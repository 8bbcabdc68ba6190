"""The zero pulse: half a cycle, the wrap at the revolution, revolutions of any size."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from witness_kit import Machine, flags, moving

from canfb.objects import StatusBit
from canfb.signal.sample import Sample
from canfb.signal.witness.zero_pulse import Pulse, PulseVerdict, ZeroPulse
from folding import each

NOTHING, AGREES = PulseVerdict.NOTHING, PulseVerdict.AGREES
CONTRADICTS, WRONG = PulseVerdict.CONTRADICTS, PulseVerdict.WRONG


def pulse_at(n: int, cycles: int, phase: float) -> ZeroPulse:
    zero = ZeroPulse(n)
    zero.set_place(Pulse(cycles, phase))
    return zero


@each("place", [(0, 0.0), (0, 0.25), (7, 0.75), (2499, 0.75), (-1, 0.75), (-2501, 0.5)])
@each("turns", [0, 1, -1, 1000, -1000, 2**40])
@each("away, error",
    [
        (0.0, 0), (0.25, 0), (0.499, 0), (0.501, 1), (0.75, 1), (1.0, 1), (1.25, 1), (1.501, 2), (7.0, 7),
        (1249.0, 1249), (1250.0, 1250), (1250.25, 1250), (1250.75, -1249), (1251.0, -1249), (2499.0, -1),
        (-0.25, 0), (-0.499, 0), (-0.501, -1), (-0.75, -1), (-1.0, -1), (-1.25, -1), (-7.0, -7),
        (-1249.0, -1249), (-1250.0, 1250),
    ],
)  # fmt: skip
def test_the_error_is_the_nearest_whole_number_of_cycles(
    place: tuple[int, float], turns: int, away: float, error: int
) -> None:
    cycles, phase = place
    whole = int(np.floor(phase + away))
    seen = cycles + turns * 2500 + whole, phase + away - whole
    assert pulse_at(2500, cycles, phase).error_cycles(Pulse(*seen)) == error


@given(st.integers(1, 100_000), st.integers(-200_000, 200_000), st.floats(-0.49, 0.49), st.integers(-9, 9))
def test_the_error_put_right_leaves_less_than_half_a_cycle(
    n: int, wrong: int, jitter: float, turns: int
) -> None:
    zero = pulse_at(n, 17, 0.5)
    cycles, phase = 17 + wrong + turns * n, 0.5 + jitter
    error = zero.error_cycles(Pulse(cycles, phase))
    assert -n / 2 < error <= n / 2
    assert (wrong - error) % n == 0
    assert zero.error_cycles(Pulse(cycles - error, phase)) == 0


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


def until_pulse(made: Machine) -> Sample:
    """The next sample that brings a pulse; those before it go through the chain."""
    while (sample := made.sample()).zero_pulse is None:
        made.chain.step(sample)
    return sample


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
        jumps = [made.chain.step(until_pulse(made)).jump_cycles]
    assert jumps == [-2]


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
