"""Windows and junctions hold every legal sample, and no more: against a linear program.

The linear program (tools/faults/samples/legal.py) shares nothing with the estimator.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from canfb.signal.bounded_motion import BoundedMotion, Spot, Window
from tools.faults.machine import positions
from tools.faults.samples.legal import least_bound

TRIALS = 30
START_ERROR = 0.05
BOUND = 0.1


MOTION = BoundedMotion(BOUND, 0.0125)


def instants_of(rng: np.random.Generator, k: int, uneven: bool, missed: int) -> np.ndarray:
    """Two samples, a hole of ``missed`` samples, then k: the last is the one that is predicted."""
    before, after = np.ones(1), np.ones(k - 1)
    hole = missed + 1.0
    if uneven:
        before, after = rng.uniform(0.3, 1.5, 1), rng.uniform(0.3, 1.5, k - 1)
        hole = max(1.6, hole + float(rng.uniform(-0.5, 0.5))) if missed else float(rng.uniform(0.3, 1.4))
    return np.concatenate(([0.0], np.cumsum([*before, hole, *after])))


def true_samples(rng: np.random.Generator, at: np.ndarray, errors: np.ndarray) -> tuple[np.ndarray, float]:
    """A motion within the bound at these instants, with errors up to ``errors``; whole speeds, too."""
    extreme = rng.uniform() < 0.5
    u = rng.choice((-1.0, 1.0), (1, 20)) if extreme else rng.uniform(-1.0, 1.0, (1, 20))
    speed = np.array([rng.uniform(-30.0, 30.0)])
    truth = positions(BOUND * u, speed, rng, at[None, :] + 3.0)[0]
    part = rng.choice((-1.0, 1.0), len(at)) if extreme else rng.uniform(-1.0, 1.0, len(at))
    return truth + part * errors, float(speed[0])


def spots_of(at: np.ndarray, samples: np.ndarray, errors: np.ndarray, phase_error: float) -> tuple[Spot, ...]:
    whole = np.floor(samples).astype(int)
    return tuple(
        Spot(float(t), int(i), float(x - i), float(e - phase_error))
        for t, i, x, e in zip(at, whole, samples, errors, strict=True)
    )


@pytest.mark.parametrize("start_error", [0.0, START_ERROR])
@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("missed", [0, 1, 2, 5])
@pytest.mark.parametrize("k", [1, 2, 3])
def test_a_junction_has_every_legal_sample_and_ends_at_the_bound(
    k: int, missed: int, uneven: bool, start_error: float
) -> None:
    """At either end of the window the least bound of a motion through all samples is the one declared."""
    rng = np.random.default_rng([k, missed, uneven])
    for trial in range(TRIALS):
        at = instants_of(rng, k, uneven, missed)
        errors = np.full(len(at), MOTION.phase_error)
        errors[0] += start_error
        samples, _ = true_samples(rng, at, errors)
        spots = spots_of(at, samples, errors, MOTION.phase_error)
        window = MOTION.beyond(spots[:2], spots[2:-1], float(at[-1]))
        low, high = window.base + window.low, window.base + window.high
        assert low - 1e-9 <= samples[-1] <= high + 1e-9
        assert spots[-1].cycles in window.counts(spots[-1].phase)
        if trial < 8:
            for end in (low, high):
                through = np.append(samples[:-1], end)
                assert least_bound(at, through, errors, 2) == pytest.approx(BOUND, abs=1e-6)


@pytest.mark.parametrize("uneven", [False, True])
def test_a_window_has_every_legal_sample(uneven: bool) -> None:
    """Of a run without a hole, also behind short intervals, where several baselines are asked."""
    rng = np.random.default_rng(int(uneven))
    for trial in range(4 * TRIALS):
        apart = rng.uniform(0.1, 1.5, 7) if uneven else np.ones(7)
        at = np.concatenate(([0.0], np.cumsum(apart)))
        errors = np.full(len(at), MOTION.phase_error)
        samples, _ = true_samples(rng, at, errors)
        spots = spots_of(at, samples, errors, MOTION.phase_error)
        window = MOTION.window(spots[:-1], float(at[-1]))
        low, high = window.base + window.low, window.base + window.high
        assert low - 1e-9 <= samples[-1] <= high + 1e-9
        if not uneven and trial < 8:  # the last r samples: the residual limit
            assert window.width == pytest.approx(2.0 * (BOUND + 4.0 * MOTION.phase_error))
            last = slice(-3, None)
            for end in (low, high):
                through = np.append(samples[:-1], end)[last]
                least = least_bound(at[last], through, MOTION.phase_error, 2)
                assert least == pytest.approx(BOUND, abs=1e-6)


def test_more_baselines_are_sharper_behind_a_short_interval() -> None:
    """0.8 intervals ahead of two samples 0.1 apart the window of these alone is 9 + 8 + 1 errors wide."""
    spots = tuple(Spot(t, 0, 0.5) for t in (0.0, 1.0, 2.0, 2.1))
    wide = MOTION.window(spots[-2:], 2.9).width
    assert wide > 2.0 * 18.0 * MOTION.phase_error
    assert MOTION.window(spots, 2.9).width < 0.55 * wide


def test_the_error_of_an_instant_counts_with_the_speed() -> None:
    slow = BoundedMotion(0.1, 0.0125, 1e-3)
    for speed in (0, 50):
        spots = tuple(Spot(float(n), speed * n, 0.5) for n in range(2))
        assert slow.window(spots, 2.0).width == pytest.approx(2.0 * (0.1 + 4.0 * (0.0125 + 1e-3 * speed)))


def test_meet_is_where_both_are() -> None:
    one, other = Window(10, -0.5, 0.75), Window(11, -0.75, 2.0)
    both = one.meet(other)
    assert (both.base + both.low, both.base + both.high) == (10.25, 10.75)
    assert list(both.counts(0.5)) == [10]
    assert list(Window(0, 0.5, 0.25).counts(0.3)) == []
    widths = [w.width for w in (both, one, Window(0, 0.5, 0.25))]
    assert all(later >= 0.0 for later in widths)
    assert [a < b for a, b in pairwise(widths)] == [True, False]
