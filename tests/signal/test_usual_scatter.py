"""What is usual is learned from the samples, and what is not is told from it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.signal.sample_times import RESTARTED, SUSPECT, TICKS, SampleTimes
from canfb.signal.usual_scatter import BEYOND, LEARNED_SAMPLES, WINDOW_SAMPLES, UsualScatter

PERIOD_TICKS = 10_000
PERIOD_S = 1e-3
FAST = 83.0  # cycles per interval


@given(st.lists(st.floats(0.0, 1e-3), min_size=1, max_size=5000))
def test_the_limit_is_that_of_the_last_samples(deviations: list[float]) -> None:
    usual = UsualScatter()
    for count, deviation in enumerate(deviations, 1):
        usual.learn(deviation)
        if count < LEARNED_SAMPLES:
            assert usual.limit_s == math.inf
        else:
            assert BEYOND * max(deviations[:count][-WINDOW_SAMPLES:]) <= usual.limit_s
            assert usual.limit_s <= BEYOND * max(deviations[:count][-2 * WINDOW_SAMPLES :])


class Clock:
    """Sample times with jitter, after 100 samples that were good; SYNC receptions if they are known."""

    def __init__(self, jitter_s: float, heard_s: float | None = None, seed: int = 1) -> None:
        self.times, self.rng = SampleTimes(), np.random.default_rng(seed)
        self.times.interval_s = PERIOD_S
        self.jitter_s, self.heard_s, self.at, self.counted = jitter_s, heard_s, 0, 0.0
        for _ in range(100):
            assert self.next() > 0.0

    def next(self, off_s: float = 0.0, speed: float = FAST) -> float:
        """What is made of the next time, which is wrong by so much."""
        self.at += 1
        self.counted += 1.0
        true_s = self.at * PERIOD_S + float(self.rng.uniform(-1.0, 1.0)) * self.jitter_s
        synced_s = None if self.heard_s is None else true_s + float(self.rng.uniform(-1, 1)) * self.heard_s
        ticks = round((true_s + off_s) / 1e-7) % TICKS
        got = self.times.elapsed(ticks, self.counted, synced_s, synced_s, speed)
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
