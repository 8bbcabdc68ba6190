"""A row of bad samples in a start with uneven sample times, or while the position is lost: no wrong speed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from unittest.mock import Mock

import numpy as np
import pytest
from test_speed_set import TAU, declared, follower, motion, offsets, started_at

from canfb.objects import LossCause
from canfb.signal.limits import Declared
from canfb.signal.speed_hypotheses import SpeedHypotheses
from canfb.signal.starts import SpeedVerdict, Starts
from canfb.signal.supervision import LOST


def jitter_at(q: float, machine: Declared) -> float:
    """Half the width of uniform instants, intervals: q = sqrt(6) sigma / (B + 4 eps)."""
    assert machine.acceleration is not None
    return q * (machine.acceleration + 4.0 * machine.phase_error) * np.sqrt(3.0 / 6.0)


def with_bad_row(
    shown: np.ndarray, machine: Declared, generator: np.random.Generator, first: int
) -> tuple[np.ndarray, slice]:
    """A row of as many bad samples as are declared or fewer, each off by whatever."""
    begin = int(generator.integers(first, 16))
    row = slice(begin, begin + int(generator.integers(1, machine.bad_samples + 1)))
    given = shown.copy()
    width = generator.choice([0.1, 0.3, 0.9])  # small ones are hard to see
    given[row] += generator.uniform(-0.5, 0.5, row.stop - row.start) * width
    return given, row


@pytest.mark.parametrize("q", [0.7, 1.0, 2.0])
@pytest.mark.parametrize("acceleration", [0.01, 0.05, 0.1])
def test_a_row_of_bad_samples_in_a_start_leaves_no_wrong_position(acceleration: float, q: float) -> None:
    """Also of a machine that turns by a few cycles per interval, whose neighbours are hard to tell apart."""
    machine = declared(acceleration)
    generator = np.random.default_rng(21)
    resolved = 0
    for _ in range(60):
        speed = float(generator.choice([0.0, 1.0, -2.0, 3.0, generator.uniform(-125.0, 125.0)]))
        elapsed, shown = motion(machine, speed, jitter_at(q, machine), 56, generator)
        given, row = with_bad_row(shown, machine, generator, first=1)
        _, off = offsets(follower(machine), elapsed, given)
        off[row] = [None] * (row.stop - row.start)
        assert {one for one in off[2:] if one is not None} <= {started_at(shown)}, (speed, row)
        resolved += off[-1] is not None
    assert resolved > 30


@pytest.mark.parametrize("acceleration", [0.01, 0.1])
def test_a_row_of_bad_samples_while_lost_leaves_no_wrong_speed(acceleration: float) -> None:
    machine = declared(acceleration)
    generator = np.random.default_rng(22)
    found = 0
    for _ in range(60):
        speed = float(generator.choice([1.0, -2.0, generator.uniform(-125.0, 125.0)]))
        elapsed, shown = motion(machine, speed, jitter_at(1.0, machine), 80, generator)
        given, _ = with_bad_row(shown, machine, generator, first=0)
        estimator = follower(machine)
        estimator.good(0.3, 1.0)
        estimator.lose(LossCause.COASTED)
        known = Mock()
        estimator.on_speed = known
        for n, (one, position) in enumerate(zip(elapsed, given, strict=True)):
            assert estimator.good(position % 1.0, one)[1] & LOST
            if known.called:
                true_speed = (shown[n] - shown[n - 1]) / one
                assert abs(estimator.tracker.step_cycles - true_speed) < 0.2, "not by whole cycles"
                found += 1
                break
    assert found > 40


def test_the_first_interval_may_be_the_unit_of_the_limits() -> None:
    """A machine at its limit: with the limit of the nominal interval the true speed had gone."""
    machine, unit = declared(0.198), 1.3
    generator = np.random.default_rng(25)
    for limit in (0.198 * unit**2, None):
        kept = []
        for _ in range(20):
            elapsed = 1.0 + generator.uniform(-0.16, 0.16, 40)
            times = np.cumsum(elapsed) - elapsed[0]
            shown = 0.3 + 7.0 * times + 0.5 * 0.198 * times**2  # in nominal intervals
            search = SpeedHypotheses(0.198, machine.phase_error, TAU, machine.bad_samples)
            for n, position in enumerate(shown):
                search.feed(position % 1.0, elapsed[n] / unit)
                if n == 0 and limit is not None:
                    search.limit(limit, TAU)
            kept.append(search.holds(int(np.floor(shown[-1]))))
        assert all(kept) is (limit is not None)


def verdicts(
    machine: Declared,
    elapsed: np.ndarray,
    shown: np.ndarray,
    factor: float = 1.0,
    changed: int | None = None,
    later: Declared | None = None,
) -> tuple[list[SpeedVerdict], float]:
    """Of the samples of a search while lost, and the speed found, per interval of the begin; NaN: none.

    At sample ``changed`` all intervals are ``factor`` times as long, and ``later`` is declared.
    """
    starts, given, unit = Starts(), machine, 1.0
    found: list[SpeedVerdict] = []
    for number, (interval, phase) in enumerate(zip(elapsed, shown % 1.0, strict=True)):
        if number == changed:
            unit, given = factor, later or machine
            starts.rescale(factor)
        time = float(interval) * unit
        if starts.begin(given, True, time, True, [], 0.0):
            found.append(starts.take(float(phase), time, True, None))
    before, last, apart = starts.last_two
    speed = (last[0] - before[0] + last[1] - before[1]) / apart * unit
    return found, speed if SpeedVerdict.FOUND in found else float("nan")


@cache
def searches_in_one_unit() -> list[tuple[np.ndarray, np.ndarray, list[SpeedVerdict], float]]:
    """Elapsed times and positions, and what a search says of them."""
    machine = declared(0.05)
    generator = np.random.default_rng(24)
    motions = [
        motion(machine, float(generator.uniform(-60.0, 60.0)), jitter_at(1.0, machine), 60, generator)
        for _ in range(30)
    ]
    return [(elapsed, shown, *verdicts(machine, elapsed, shown)) for elapsed, shown in motions]


@pytest.mark.parametrize("changed", [2, 3, 7])
@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_search_means_the_same_in_another_unit(factor: float, changed: int) -> None:
    later = replace(declared(0.05 / factor**2), instant_error=TAU * factor)
    resolved = 0
    for elapsed, shown, known, speed in searches_in_one_unit():
        other, same = verdicts(declared(0.05), elapsed, shown, factor, changed, later)
        assert known == other
        assert same == pytest.approx(speed, nan_ok=True)
        resolved += speed == speed
    assert resolved > 3
