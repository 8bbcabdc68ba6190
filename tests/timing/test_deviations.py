"""How far SYNCs usually are off: a step within the noise shows, and no noise of its own kind is a step."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import numpy.typing as npt
import pytest

from canfb.timing.deviations import BEYOND, PEAKS, TOGETHER, Deviations
from canfb.timing.judge import Judge

PERIOD_S = 1e-3
Noise = npt.NDArray[np.float64]


def uniform(rng: np.random.Generator, count: int) -> Noise:
    return rng.uniform(0.0, 60e-6, count)


def gaussian(rng: np.random.Generator, count: int) -> Noise:
    return rng.normal(0.0, 20e-6, count)


def frames_before(rng: np.random.Generator, count: int) -> Noise:
    """One SYNC of ten waits for a frame that is on the bus."""
    return rng.uniform(0.0, 135e-6, count) * (rng.uniform(size=count) < 0.1) + rng.normal(0.0, 2e-6, count)


def wander(rng: np.random.Generator, count: int) -> Noise:
    """A producer whose timer is corrected now and then: each deviation has much of the one before."""
    steps, level = rng.normal(0.0, 4e-6, count), 0.0
    noise = np.empty(count)
    for n, step in enumerate(steps):
        level = 0.98 * level + step
        noise[n] = level
    return noise


def swing(rng: np.random.Generator, count: int) -> Noise:
    return 40e-6 * np.sin(np.arange(count) * 0.05 + rng.uniform(0.0, 6.0)) + rng.normal(0.0, 3e-6, count)


def quiet(rng: np.random.Generator, count: int) -> Noise:
    return rng.normal(0.0, 0.2e-6, count)


KINDS = (uniform, gaussian, frames_before, wander, swing, quiet)


def doubts(judge: Judge, times_s: Noise) -> Iterator[tuple[int, float]]:
    """Which SYNCs put the instants in doubt, and by how much, periods; each is answered."""
    for n, time_s in enumerate(times_s.tolist()):
        verdict = judge.syncs.sync(time_s, True, None)
        if verdict.doubt:
            yield n, verdict.doubt
        judge.answered_last_sync()


@pytest.mark.parametrize("kind", KINDS)
def test_what_sync_does_all_the_time_is_no_step(kind: Callable[[np.random.Generator, int], Noise]) -> None:
    for seed in range(4):
        rng = np.random.default_rng(seed)
        times_s = np.arange(6000) * PERIOD_S + kind(rng, 6000)
        assert list(doubts(Judge(), times_s)) == []


@pytest.mark.parametrize(("kind", "step_s"), [(uniform, 32e-6), (gaussian, 46e-6), (quiet, 15e-6)])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_step_within_the_noise_shows(
    kind: Callable[[np.random.Generator, int], Noise], step_s: float, sign: float
) -> None:
    shown = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        fault = int(rng.integers(260, 1500))
        times_s = np.arange(fault + 200) * PERIOD_S + kind(rng, fault + 200)
        times_s[fault:] += sign * step_s
        found = list(doubts(Judge(), times_s))
        assert all(n > fault for n, _ in found)
        shown += any(n <= fault + 64 and doubt > 0.4 * step_s / PERIOD_S for n, doubt in found)
    assert shown >= 7, "a mean of 32 deviates, too"


def test_after_a_step_the_new_grid_is_the_usual_one() -> None:
    rng = np.random.default_rng(1)
    times_s = np.arange(3000) * PERIOD_S + gaussian(rng, 3000)
    times_s[1000:] += 40e-6
    judge = Judge()
    assert all(n <= 1100 for n, _ in doubts(judge, times_s))
    assert judge.syncs.clock.period_s == pytest.approx(PERIOD_S, rel=1e-4)


def test_the_largest_deviation_bounds_the_jitter() -> None:
    rng, deviations = np.random.default_rng(2), Deviations()
    for _ in range(20):
        errors = rng.uniform(-50e-6, 50e-6, TOGETHER).tolist()
        deviations.learn(errors, 0.0, PERIOD_S, True)
    assert deviations.jitter == pytest.approx(BEYOND * 50e-3, rel=0.15), "8 mean deviations would be 0.2"
    for _ in range(2 * PEAKS):
        errors = rng.uniform(-10e-6, 10e-6, TOGETHER).tolist()
        deviations.learn(errors, 0.0, PERIOD_S, True)
    assert deviations.jitter == pytest.approx(BEYOND * 10e-3, rel=0.15), "and what was is forgotten"
