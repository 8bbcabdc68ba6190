"""What is usual is learned from the samples, and what is not is told from it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.signal.sample import TICKS
from canfb.signal.sample_times import LINE_PART, RESTARTED, SUSPECT, SampleTimes
from canfb.signal.usual_scatter import (
    BEYOND,
    LEARNED_SAMPLES,
    START_PART,
    WINDOW_SAMPLES,
    UsualScatter,
)

PERIOD_TICKS = 10_000
PERIOD_S = 1e-3
FAST = 83.0  # cycles per interval


@given(st.lists(st.floats(0.0, 1e-3), min_size=1, max_size=5000))
def test_the_limit_is_that_of_the_last_samples(deviations: list[float]) -> None:
    usual = UsualScatter()
    for count, deviation in enumerate(deviations, 1):
        usual.learn(deviation)
        least = START_PART * PERIOD_S if count < LEARNED_SAMPLES else 0.0
        limit = usual.limit_of(PERIOD_S, LINE_PART)
        most = LINE_PART * PERIOD_S
        assert min(most, max(least, BEYOND * max(deviations[:count][-WINDOW_SAMPLES:]))) <= limit
        assert limit <= min(most, max(least, BEYOND * max(deviations[:count][-2 * WINDOW_SAMPLES :])))


def test_what_was_refused_is_learned_at_the_third_time_only() -> None:
    usual = UsualScatter()
    for _ in range(LEARNED_SAMPLES):
        usual.learn(1e-6)
    usual.refuse(1e-4)
    usual.refuse(2e-4)
    assert usual.limit_of(PERIOD_S, LINE_PART) == 2e-6
    usual.refuse(1.5e-4)
    assert usual.limit_of(PERIOD_S, LINE_PART) == 4e-4


def test_what_was_refused_long_ago_is_forgotten() -> None:
    usual = UsualScatter()
    for _ in range(4):
        usual.refuse(1e-4)
        for _ in range(WINDOW_SAMPLES):
            usual.learn(1e-6)
    assert usual.limit_of(PERIOD_S, LINE_PART) == 2e-6


def test_before_anything_is_learned_no_error_can_cost_another_cycle() -> None:
    """From standstill, at half the limit, with the error that the limit of the start passes."""
    limit, acceleration = 1.0 / 3.0, 1.0 / 6.0
    fastest = LEARNED_SAMPLES * acceleration
    assert START_PART * fastest <= 1.0 - limit - acceleration


class Clock:
    """Sample times with jitter, after 100 samples that were good; SYNC receptions if they are known."""

    def __init__(
        self,
        jitter_s: float,
        heard_s: float | None = None,
        seed: int = 1,
        learned: int = 100,
        proved: bool = True,
    ) -> None:
        self.times, self.rng = SampleTimes(), np.random.default_rng(seed)
        self.times.sync_interval_s = PERIOD_S
        self.jitter_s, self.heard_s, self.at, self.counted = jitter_s, heard_s, 0, 0.0
        self.proved, self.moved_s = proved, 0.0
        for n in range(learned):
            assert self.next(speed=FAST if n > LEARNED_SAMPLES else 0.0) > 0.0

    def next(self, off_s: float = 0.0, speed: float = FAST, late_s: float = 0.0) -> float:
        """What is made of the next time, which is wrong by so much; the host takes SYNC so late."""
        self.at += 1
        self.counted += 1.0
        true_s = self.moved_s + self.at * PERIOD_S + float(self.rng.uniform(-1.0, 1.0)) * self.jitter_s
        synced_s = None
        if self.heard_s is not None:
            synced_s = true_s + late_s + float(self.rng.uniform(-1, 1)) * self.heard_s
        ticks = round((true_s + off_s) / 1e-7) % TICKS
        got = self.times.elapsed(ticks, self.counted, synced_s if self.proved else None, synced_s, speed)
        if got > 0.0 or got == RESTARTED:
            self.counted = 0.0
        return got


@pytest.mark.parametrize("heard_s", [None, 5e-6])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_one_time_that_is_off_by_more_than_usual_costs_one_sample(heard_s: float | None, sign: float) -> None:
    clock = Clock(20e-6, heard_s)
    assert clock.next(sign * 150e-6) == SUSPECT
    assert clock.next() == pytest.approx(2.0, abs=0.1), "from the last good one"
    assert all(clock.next() == pytest.approx(1.0, abs=0.1) for _ in range(200))


def test_the_receptions_of_sync_show_what_the_jitter_hides() -> None:
    assert Clock(100e-6).next(60e-6) > 0.0
    assert Clock(100e-6, 5e-6).next(60e-6) == SUSPECT


def test_a_machine_that_cannot_lose_a_cycle_by_it_is_not_troubled() -> None:
    assert Clock(20e-6).next(300e-6, speed=0.4) > 0.0
    assert Clock(20e-6).next(300e-6, speed=0.6) == SUSPECT


def test_a_clock_that_was_set_is_restarted() -> None:
    clock = Clock(20e-6)
    assert clock.next(300e-6) == SUSPECT
    assert clock.next(300e-6) == RESTARTED
    assert all(clock.next(300e-6) > 0.0 for _ in range(100))


@pytest.mark.parametrize("heard_s", [None, 5e-6])
@pytest.mark.parametrize("later", [2, 30, 600])
def test_the_same_wrong_time_again_is_refused_again(heard_s: float | None, later: int) -> None:
    clock = Clock(20e-6, heard_s)
    assert clock.next(150e-6) == SUSPECT
    assert all(clock.next() > 0.0 for _ in range(later))
    assert clock.next(150e-6) == SUSPECT


@pytest.mark.parametrize("heard_s", [None, 5e-6])
@pytest.mark.parametrize("after", range(1, 32))
def test_a_wrong_time_at_the_start_is_refused_too(heard_s: float | None, after: int) -> None:
    """A cycle costs more than 3/32 of an interval at the speed that it can have by then."""
    clock = Clock(5e-6, heard_s, learned=after)
    assert clock.next(PERIOD_S / 8.0, speed=8.0) == SUSPECT
    assert clock.next() > 0.0


@pytest.mark.parametrize("proved", [None, False])
@pytest.mark.parametrize("off_s", [-0.49e-3, 0.49e-3])
def test_a_time_half_an_interval_off_is_refused_while_jitter_is_learned(
    off_s: float, proved: bool | None
) -> None:
    """From the line through the first times it is further off than any of them, twice; from the time before,
    which jitters as well, it may not be.
    """
    for seed in range(40):
        clock = Clock(0.0, None if proved is None else 20e-6, seed, learned=0, proved=bool(proved))
        for n in range(8 + seed % 8):
            assert clock.next(float(clock.rng.uniform(-100e-6, 100e-6)), speed=0.0) > 0.0, n
        assert clock.next(off_s) == SUSPECT, seed
        assert clock.next() > 0.0, seed


def test_a_start_with_more_jitter_than_the_bound_learns_it_at_rest() -> None:
    clock = Clock(150e-6, learned=0)
    assert all(clock.next(speed=0.0) > 0.0 for _ in range(32))
    assert all(clock.next() > 0.0 for _ in range(200))


def test_a_reset_forgets_what_is_usual() -> None:
    clock = Clock(100e-6)
    assert clock.next(150e-6) > 0.0
    clock.times.reset()
    assert clock.next(speed=0.0) > 0.0
    assert clock.next(150e-6) == SUSPECT


def test_jitter_that_begins_is_learned() -> None:
    """SYNCs that wait for the frame before them, one in five, after a time without: few samples are lost."""
    clock = Clock(1e-6)
    got = [clock.next(135e-6 if clock.rng.uniform() < 0.2 else 0.0) for _ in range(2000)]
    assert 1 <= sum(one < 0.0 for one in got) <= 4


@pytest.mark.parametrize("jitter_s", [1e-6, 20e-6, 100e-6])
def test_gaussian_jitter_is_not_flagged(jitter_s: float) -> None:
    rng = np.random.default_rng(7)
    clock = Clock(jitter_s)
    for off in rng.normal(0.0, jitter_s, 20_000).tolist():
        assert clock.next(off) > 0.0


@pytest.mark.parametrize("seed", range(8))
def test_the_time_before_does_not_hide_a_wrong_one(seed: int) -> None:
    """An error of 3.2 times the jitter: from the line at least 2.2, from the time before only 1.2."""
    clock = Clock(100e-6, seed=seed, learned=400)
    assert clock.next(320e-6) == SUSPECT
    assert clock.next() > 0.0
    assert clock.next(-320e-6) == SUSPECT


def test_what_no_sync_was_off_by_and_the_host_contradicts_is_refused() -> None:
    """A host that may be late makes no time right, and takes none away that SYNC has had before."""
    clock = Clock(100e-6, 20e-6, proved=False, learned=200)
    for off_s in (210e-6, -210e-6):
        got = clock.next(off_s)
        assert got == SUSPECT or abs(got - 1.0) <= 0.21
        assert clock.next() > 0.0
    assert Clock(100e-6, learned=200).next(60e-6) > 0.0


@pytest.mark.parametrize("late_s", [1e-3, 15e-3])
def test_a_host_that_was_late_takes_no_time_away(late_s: float) -> None:
    clock = Clock(100e-6, 20e-6, proved=False, learned=200)
    assert all(clock.next(late_s=late_s) > 0.0 for _ in range(400))


def test_a_sync_that_moves_by_more_than_receptions_jitter_sets_no_clock() -> None:
    """A shift that would cost cycles: one sample waits for the second that is off as much."""
    clock = Clock(0.0, 25e-6)
    clock.moved_s = 80e-6
    got = [clock.next() for _ in range(200)]
    assert [one for one in got if one <= 0.0] in ([], [SUSPECT])


@pytest.mark.parametrize("proved", [False, True])
def test_a_sync_that_was_late_is_witnessed_by_both_clocks(proved: bool) -> None:
    """A producer that stalls: SYNCs are not sent, one is late, the next one is on its grid again."""
    clock = Clock(10e-6, 20e-6, proved=proved, learned=300)
    clock.at += 2
    clock.moved_s = 0.6e-3
    assert clock.next() == pytest.approx(3.6, abs=0.05)
    clock.moved_s = 0.0
    assert clock.next() == pytest.approx(0.4, abs=0.05)
    assert all(clock.next() == pytest.approx(1.0, abs=0.05) for _ in range(100))


def test_a_host_that_is_always_late_witnesses_nothing() -> None:
    clock = Clock(10e-6, 3e-3, proved=False, learned=300)
    assert clock.next(2.6e-3) == SUSPECT


def after_a_stall(seed: int, lost: int, off_s: float = 0.0) -> float:
    """The host stalls for 12 periods and does not say when frames came; ``lost`` of them are dropped."""
    clock = Clock(10e-6, 20e-6, seed=seed, proved=False, learned=300)
    for waits in range(12, 0, -1):
        assert clock.next(late_s=waits * PERIOD_S) > 0.0
    clock.at += lost
    return clock.next(off_s)


@pytest.mark.parametrize("seed", range(5))
def test_frames_that_waited_for_a_late_host_are_known_to_have_waited(seed: int) -> None:
    for lost in range(1, 8):
        assert after_a_stall(seed, lost) == pytest.approx(lost + 1.0, abs=0.05)


@pytest.mark.parametrize("seed", range(5))
def test_a_wrong_time_behind_a_stall_is_none_of_lost_frames(seed: int) -> None:
    for lost, wrong in ((0, 1), (0, 3), (2, 2), (5, 1), (5, 7)):
        assert after_a_stall(seed, lost, wrong * PERIOD_S) == SUSPECT


def test_a_time_that_is_wrong_by_periods_is_no_sync_that_was_late() -> None:
    for proved in (False, True):
        assert Clock(10e-6, 20e-6, proved=proved, learned=300).next(1.7e-3) in (SUSPECT, RESTARTED)
