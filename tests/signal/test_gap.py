"""Gaps of missed samples in a machine whose acceleration does what it likes: never valid and wrong."""

from __future__ import annotations

import itertools
import math
from collections import Counter

import gap_kit
import numpy as np
import pytest
from gap_kit import BEFORE, NOISE_CYCLES, SMOOTH, VIOLENT, Motion, Outcome, play
from hypothesis import given
from hypothesis import strategies as st

from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import ChainConfig
from canfb.signal.recovery.gap import Unseen, fitting, sure_acceleration, within
from canfb.signal.recovery.recovery import Recovery
from canfb.signal.sample import Sample
from canfb.signal.tracker import Tracker

PHASE_MARGIN = 0.05
EPISODES = 45  # of each motion and number of missed samples: 10^4 in all


def outcomes(
    motion: Motion, missed: int, low: float, high: float, *, known: bool, limit: float | None = None
) -> Counter[Outcome]:
    """Of machines whose largest acceleration is anywhere from low to high."""
    rng = np.random.default_rng([missed, len(motion.__name__)])
    seen: Counter[Outcome] = Counter()
    for _ in range(EPISODES):
        most = float(rng.uniform(low, high))
        residual = min(1 / 3, most + PHASE_MARGIN) if limit is None else limit
        seen[play(motion(most, missed, rng), missed, residual, most if known else None, rng)] += 1
    return seen


@pytest.mark.parametrize("missed", [1, 2, 3])
@pytest.mark.parametrize("motion", SMOOTH + VIOLENT)
def test_a_known_acceleration_that_leaves_one_trajectory_keeps_the_position(
    motion: Motion, missed: int
) -> None:
    """Whatever the machine does below it. L = a + 0.05, and (n + 2) (L + a) <= 1, or its second form."""
    most = (1.0 - PHASE_MARGIN * (5.0, 6.0, 7.0)[missed - 1]) * sure_acceleration(missed + 1)
    assert set(outcomes(motion, missed, 0.0, most, known=True)) == {Outcome.RIGHT}


@pytest.mark.parametrize("missed", [1, 2, 3])
@pytest.mark.parametrize("motion", SMOOTH + VIOLENT)
def test_no_position_is_valid_and_wrong_up_to_any_known_acceleration(motion: Motion, missed: int) -> None:
    assert outcomes(motion, missed, 0.01, 0.28, known=True)[Outcome.WRONG] == 0


@pytest.mark.parametrize("missed", [1, 2, 3])
@pytest.mark.parametrize("motion", [m for m in SMOOTH + VIOLENT if m is not gap_kit.doublet])
def test_nor_while_it_is_not_known(motion: Motion, missed: int) -> None:
    assert outcomes(motion, missed, 0.01, 0.28, known=False, limit=1 / 3)[Outcome.WRONG] == 0


@pytest.mark.parametrize("motion", [*SMOOTH, gap_kit.pulse_seen])
@pytest.mark.parametrize(
    ("limit", "known", "most"),
    [(1 / 3, None, 1 / 6), (1 / 3, None, 0.1), (0.3, 0.25, 0.125), (0.25, 0.2, 0.1), (0.18, 0.13, 0.13)],
)
def test_one_missed_sample_costs_nothing_at_half_the_limit(
    motion: Motion, limit: float, known: float | None, most: float
) -> None:
    rng = np.random.default_rng(7)
    for _ in range(EPISODES):
        assert play(motion(most, 1, rng), 1, limit, known, rng) is Outcome.RIGHT


@pytest.mark.parametrize("size", [0.16, 0.18, 0.2, 0.22, 0.25, -0.2])
@pytest.mark.parametrize(("limit", "known"), [(0.3, 0.25), (1 / 3, None), (1 / 3, 0.3)])
@pytest.mark.parametrize("missed", [1, 2, 3])
def test_a_push_from_before_the_gap_to_after_it(
    size: float, limit: float, known: float | None, missed: int
) -> None:
    rng = np.random.default_rng(3)
    for begin, end in itertools.product((1, 2, 3), (1, 3, 5)):
        made = np.zeros(gap_kit.length(missed))
        made[BEFORE - begin : BEFORE + missed + end] = size
        assert play(made, missed, limit, known, rng) is not Outcome.WRONG


def test_two_legal_motions_with_the_same_phases() -> None:
    """2 (L + a) <= 1 is not enough: both machines stay below 0.2, and no sample tells one from the other."""
    one, other = np.full(40, 0.2), np.full(40, 0.2)
    other[BEFORE : BEFORE + 3] = 0.2 - 1 / 3
    away = np.cumsum(np.cumsum(one - other))
    delivered = np.delete(away, BEFORE)
    assert np.abs(delivered - np.rint(delivered)).max() < 1e-9
    assert np.rint(delivered[-1]) > 1
    assert np.abs(other).max() <= 0.2
    assert 3 * (0.2 + 0.2) > 1 >= 2 * (0.3 + 0.2)


def chain_over_a_gap(known: float, missed: int) -> tuple[Recovery, float]:
    recovery, position = Recovery(Tracker(known + PHASE_MARGIN), 3), 0.1
    recovery.acceleration_limit = known
    for _ in range(20):
        recovery.good(position % 1.0, 1.0)
        position += 0.02
    for _ in range(missed):
        recovery.bad(1.0, missed=True)
        position += 0.02
    return recovery, position


def test_valid_in_the_first_sample_where_no_other_position_is_possible() -> None:
    recovery, position = chain_over_a_gap(0.1, 1)
    track, bits = recovery.good(position % 1.0, 1.0)
    assert (track.cycles + track.phase, bits) == (pytest.approx(position), 1)
    assert recovery.in_doubt, "the next one must confirm its speed"
    track, bits = recovery.good((position + 0.02) % 1.0, 1.0)
    assert (track.cycles + track.phase, bits) == (pytest.approx(position + 0.02), 1)
    assert not recovery.in_doubt


def test_contradicted_by_the_second_sample_it_is_not_valid() -> None:
    recovery, position = chain_over_a_gap(0.05, 1)
    assert recovery.good(position % 1.0, 1.0)[1] == 1
    assert not recovery.good((position + 0.5) % 1.0, 1.0)[1] & 1


def test_another_missed_sample_before_the_second_makes_the_gap_longer() -> None:
    recovery, position = chain_over_a_gap(0.04, 1)
    assert recovery.good(position % 1.0, 1.0)[1] == 1
    assert recovery.bad(1.0, missed=True)[1] == 2
    track, bits = recovery.good((position + 0.04) % 1.0, 1.0)
    track, bits = recovery.good((position + 0.06) % 1.0, 1.0)
    assert (track.cycles + track.phase, bits) == (pytest.approx(position + 0.06), 1)


@given(
    st.integers(2, 4).flatmap(
        lambda n: st.tuples(st.just(n), st.lists(st.floats(-1, 1), min_size=n + 1, max_size=n + 1))
    ),
    st.floats(0, 0.3),
    st.integers(-3, 3),
    st.integers(-3, 3),
)
def test_what_fits_holds_what_happened(
    drawn: tuple[int, list[float]], limit: float, cycles: int, step: int
) -> None:
    intervals, parts = drawn
    unseen = [limit * part for part in parts]
    change = sum(unseen)
    way = sum((intervals - k) * one for k, one in enumerate(unseen))
    found = fitting(Unseen(intervals, way - cycles, change - step), within(limit, intervals, 1e-9))
    assert (cycles, step) in found
    if limit < sure_acceleration(intervals) - 1e-6:
        assert found == [(cycles, step)]


@pytest.mark.parametrize(("intervals", "sure"), [(2, 1 / 6), (3, 1 / 8), (4, 1 / 12), (5, 1 / 18)])
def test_the_sure_acceleration_is_sharp(intervals: int, sure: float) -> None:
    assert sure_acceleration(intervals) == pytest.approx(sure)
    # Accelerations of that size and their opposites lead to the same phases.
    signs = {2: (1, 1, 1), 3: (1, 1, -1, -1), 4: (1, 1, 0, -1, -1), 5: (1, 1, 1, -1, -1, -1)}[intervals]
    way = sure * sum((intervals - k) * sign for k, sign in enumerate(signs))
    unseen = Unseen(intervals, way, sure * sum(signs))
    assert len(fitting(unseen, within(sure, intervals, 1e-9))) == 2
    assert fitting(unseen, within(sure - 1e-6, intervals, 1e-9)) == []


@pytest.mark.parametrize("missed", [1, 2, 3])
@pytest.mark.parametrize("bad", [False, True])
@pytest.mark.parametrize("seed", range(40))
def test_speed_and_acceleration_of_the_first_valid_sample_after_a_fault(
    seed: int, bad: bool, missed: int
) -> None:
    rng = np.random.default_rng(seed)
    acceleration = np.concatenate(
        (np.zeros(3), np.full(150, 0.2), np.zeros(5), np.full(92, rng.uniform(-0.02, 0.02)))
    )
    speed = np.cumsum(acceleration)
    truth = rng.uniform() + np.cumsum(speed)
    chain = SignalChain(ChainConfig())
    at = 200 + int(rng.integers(20))
    compared = []
    for k in range(at + 20):
        angle = 2.0 * math.pi * (truth[k] + rng.normal(0.0, NOISE_CYCLES))
        sample = Sample(1500.0 * math.sin(angle), 1500.0 * math.cos(angle))
        if at <= k < at + missed:
            got = chain.step(Sample(0.0, 0.0)) if bad else chain.miss()
        else:
            got = chain.step(sample)
        if k >= at and got.valid:
            compared.append(got)
            assert got.speed_cycles == pytest.approx(speed[k], abs=0.1)
            assert got.acceleration_cycles == pytest.approx(acceleration[k], abs=0.1)
    assert len(compared) > 8 or bad, "after bad samples in a row too rough to be sure it may be lost"
