"""A start in motion, and the speed of a lost position, by uneven sample times alone.

The machine accelerates and errs as much as is declared, at random; rows of samples are bad or missed.
"""

from collections.abc import Callable
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from canfb.objects import LossCause
from canfb.signal.bounded_motion import BoundedMotion
from canfb.signal.estimator import Estimator
from canfb.signal.limits import Declared
from canfb.signal.speed_hypotheses import SpeedHypotheses, SpeedSet
from canfb.signal.supervision import COASTING, LOST, VALID
from folding import each

TAU = 5e-5  # 50 ns of 1 ms


def declared(acceleration: float, phase_error: float = 0.0125) -> Declared:
    return Declared(
        residual_limit=acceleration + 4.0 * phase_error,
        widest_limit=1.0 / 3.0,
        acceleration=acceleration,
        phase_error=phase_error,
        instant_error=TAU,
        coast_samples=8,
    )


def follower(machine: Declared) -> Estimator:
    """An estimator of samples that bring their time."""
    estimator = Estimator(machine)
    estimator.timed = True
    return estimator


def motion(
    machine: Declared, speed: float, jitter: float, samples: int, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Elapsed times of samples, intervals, and the positions that they show, cycles."""
    times = np.arange(samples) + generator.uniform(-jitter, jitter, samples)
    fine = np.linspace(times[0], times[-1], 40 * samples)
    bends = machine.acceleration * np.repeat(generator.choice([-1.0, 1.0], 4 * samples), 10)
    way = np.cumsum(np.cumsum(bends) * (fine[1] - fine[0]) ** 2)
    x = np.interp(times, fine, way) * 0.999 + speed * times + generator.uniform(0.0, 1.0)
    shown = x + generator.uniform(-0.9, 0.9, samples) * machine.phase_error
    measured = np.round(times / (2.0 * TAU)) * 2.0 * TAU
    return np.diff(measured, prepend=measured[0] - 1.0), shown


def offsets(
    estimator: Estimator, elapsed: np.ndarray, shown: np.ndarray, missed: tuple[int, ...] = ()
) -> tuple[list[int], list[int | None]]:
    """Status bits, and cycles between what is shown and what is counted, where it is valid."""
    bits: list[int] = []
    off: list[int | None] = []
    waited = 0.0
    for n, (one, position) in enumerate(zip(elapsed, shown, strict=True)):
        waited += one
        if n in missed:
            bits.append(estimator.bad(1.0, missed=True)[1])
            off.append(None)
            waited -= 1.0
            continue
        track, status = estimator.good(position % 1.0, waited)
        waited = 0.0
        bits.append(status)
        off.append(round(track.cycles + track.phase - position) if status & VALID else None)
    return bits, off


def started_at(shown: np.ndarray) -> int:
    return -int(np.floor(shown[0]))


@pytest.mark.parametrize(("acceleration", "jitter"), [(0.01, 0.1), (0.05, 0.1), (0.01, 0.03), (0.05, 0.05)])
def test_a_start_in_motion_is_never_valid_and_wrong_but_resolved(acceleration: float, jitter: float) -> None:
    machine = declared(acceleration)
    generator = np.random.default_rng(3)
    samples = []
    for _ in range(60):
        speed = float(generator.uniform(-125.0, 125.0))
        if generator.random() < 0.5:
            speed = round(speed)  # phases as at standstill
        elapsed, shown = motion(machine, speed, jitter, 80, generator)
        _, off = offsets(follower(machine), elapsed, shown)
        wrong = [n for n, one in enumerate(off) if one is not None and one != started_at(shown)]
        assert not wrong, (speed, wrong)
        later = [n for n, one in enumerate(off) if one is not None and n > 1]
        samples.append(later[0] if later else 80)
    assert np.median(samples) <= (20 if jitter == 0.1 else 60)
    if jitter == 0.1:
        assert max(samples) < 40


@pytest.mark.parametrize(("acceleration", "median", "most"), [(0.01, 8, 12), (0.1, 15, 24)])
def test_one_speed_is_left_after_a_few_uneven_samples(acceleration: float, median: int, most: int) -> None:
    """q = 2.4 and 0.94 (docs/supervision.md); the true speed is the one that is left."""
    machine = declared(acceleration)
    generator = np.random.default_rng(6)
    samples = []
    for _ in range(100):
        speed = float(generator.uniform(-125.0, 125.0))
        elapsed, shown = motion(machine, speed, 0.1, 60, generator)
        speeds, bounds = SpeedSet(1000), BoundedMotion(acceleration, machine.phase_error, TAU)
        for one, position in zip(elapsed, shown, strict=True):
            assert speeds.feed(position % 1.0, one, bounds)
            assert speeds.has(int(np.floor(position)) - int(np.floor(shown[0])))
            if speeds.left == 1 and speeds.samples > 2:
                break
        samples.append(speeds.samples)
    assert 4 <= np.median(samples) <= median
    assert np.quantile(samples, 0.95) <= most


@pytest.mark.parametrize("jitter", [0.1, 0.02, 0.003, 0.0])
def test_a_start_at_standstill_waits_until_the_times_have_told(jitter: float) -> None:
    machine = declared(0.01)
    generator = np.random.default_rng(4)
    for _ in range(30):
        elapsed, shown = motion(machine, 0.0, jitter, 120, generator)
        bits, off = offsets(follower(machine), elapsed, shown)
        assert set(bits[100:]) == {VALID}
        assert {one for one in off if one is not None} == {started_at(shown)}
        if not jitter:
            assert bits[1:7] == [COASTING] * 6, "the next time may be uneven"
            assert set(bits[7:]) == {VALID}, "the times tell nothing"
        elif abs(elapsed[1] - 1.0) > 1e-3:
            assert bits[1] == COASTING


def jitter_at(q: float, machine: Declared) -> float:
    """Half the width of uniform instants, intervals: q = sqrt(6) sigma / (B + 4 eps)."""
    assert machine.acceleration is not None
    return q * (machine.acceleration + 4.0 * machine.phase_error) * np.sqrt(3.0 / 6.0)


def with_bad_row(
    shown: np.ndarray, machine: Declared, generator: np.random.Generator, first: int = 1
) -> tuple[np.ndarray, slice]:
    """A row of as many bad samples as are declared or fewer, each off by whatever."""
    begin = int(generator.integers(first, 16))
    row = slice(begin, begin + int(generator.integers(1, machine.bad_samples + 1)))
    given = shown.copy()
    width = generator.choice([0.1, 0.3, 0.9])  # small ones are hard to see
    given[row] += generator.uniform(-0.5, 0.5, row.stop - row.start) * width
    return given, row


def with_one_bad(
    shown: np.ndarray, machine: Declared, generator: np.random.Generator
) -> tuple[np.ndarray, slice]:
    """It removes the truth of a standstill; of seven one is wrong, by sample 28, if no row is left out."""
    bad, given = int(generator.integers(1, 9)), shown.copy()
    size = generator.uniform(0.8, 1.6) * machine.residual_limit / 2.0
    given[bad] += generator.choice((-1.0, 1.0)) * size
    return given, slice(bad, bad + 1)


@each("spoil, acceleration, jitter", [
    # The times deviate so little that one cycle more per interval lasts long.
    *((with_one_bad, *case) for case in ((0.01, 0.01), (0.05, 0.02), (0.1, 0.03))),
    *((with_bad_row, a, jitter_at(q, declared(a))) for a in (0.01, 0.05, 0.1) for q in (0.7, 1.0, 2.0)),
])  # fmt: skip
def test_bad_samples_in_a_start_leave_no_wrong_position(
    spoil: Callable[..., tuple[np.ndarray, slice]], acceleration: float, jitter: float
) -> None:
    """Also of a machine that turns by a few cycles per interval, whose neighbours are hard to tell apart."""
    machine, generator, resolved = declared(acceleration), np.random.default_rng(21), 0
    for _ in range(60):
        turning = [0.0, 1.0, -2.0, 3.0, generator.uniform(-125.0, 125.0)]
        speed = 0.0 if spoil is with_one_bad else float(generator.choice(turning))
        elapsed, shown = motion(machine, speed, jitter, 68, generator)
        given, row = spoil(shown, machine, generator)
        _, off = offsets(follower(machine), elapsed, given)
        off[row] = [None] * (row.stop - row.start)
        begin = 2 if speed else 0
        assert {one for one in off[begin:] if one is not None} <= {started_at(shown)}, (speed, row)
        resolved += off[-1] is not None
    assert resolved > 30 or spoil is with_one_bad


def first_speed(
    machine: Declared,
    elapsed: np.ndarray,
    given: np.ndarray,
    unit: float = 1.0,
    changed: int = 0,
    later: Declared | None = None,
) -> tuple[int, float]:
    """The sample at which a lost position has its speed, per interval of the begin; 0 and NaN: none.

    From sample ``changed`` on intervals are ``unit`` times as long, and ``later`` is declared.
    """
    estimator, factor = follower(machine), 1.0
    estimator.good(0.3, 1.0)
    estimator.lose(LossCause.COASTED)
    estimator.on_speed = known = Mock()
    for n, (one, position) in enumerate(zip(elapsed, given, strict=True)):
        if n == changed and later is not None:
            factor = unit
            estimator.rescale(unit)
            estimator.declare(later)
        assert estimator.good(position % 1.0, one * factor)[1] & LOST
        if known.called:
            return n, estimator.tracker.step_cycles * factor
    return 0, float("nan")


@pytest.mark.parametrize("acceleration", [0.01, 0.1])
@pytest.mark.parametrize("spoilt", [False, True])
def test_a_lost_position_gets_its_speed_and_no_count(acceleration: float, spoilt: bool) -> None:
    machine, generator, found = declared(acceleration), np.random.default_rng(22), 0
    for _ in range(60):
        speed = float(generator.choice([1.0, -2.0, generator.uniform(-125.0, 125.0)]))
        elapsed, shown = motion(machine, speed, jitter_at(1.0, machine), 80, generator)
        given = with_bad_row(shown, machine, generator, first=0)[0] if spoilt else shown
        n, known = first_speed(machine, elapsed, given)
        if n:
            assert abs(known - (shown[n] - shown[n - 1]) / elapsed[n]) < 0.2, "not by whole cycles"
            found += 1
    assert found > 40


@pytest.mark.parametrize("changed", [2, 3, 7])
@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_search_means_the_same_in_another_unit(factor: float, changed: int) -> None:
    machine, later = declared(0.05), replace(declared(0.05 / factor**2), instant_error=TAU * factor)
    generator, resolved = np.random.default_rng(24), 0
    for _ in range(15):
        speed = float(generator.uniform(-60.0, 60.0))
        elapsed, shown = motion(machine, speed, jitter_at(1.0, machine), 60, generator)
        n, known = first_speed(machine, elapsed, shown)
        assert first_speed(machine, elapsed, shown, factor, changed, later) == (
            n,
            pytest.approx(known, nan_ok=True),
        )
        resolved += n > changed
    assert resolved > 3


@pytest.mark.parametrize("jitter", [0.1, 0.03])
def test_a_first_interval_that_is_even_by_chance_makes_no_start_in_motion_valid(jitter: float) -> None:
    """The first interval is the unit of the next ones, where nothing else says how long it is."""
    machine = declared(0.01)
    generator = np.random.default_rng(12)
    for _ in range(60):
        speed = float(generator.uniform(2.0, 125.0))
        elapsed, shown = motion(machine, speed, jitter, 60, generator)
        elapsed = elapsed / elapsed[1]
        _, off = offsets(follower(machine), elapsed, shown)
        assert {one for one in off[1:] if one is not None} <= {started_at(shown)}, speed


def test_a_position_lost_before_its_first_sample_starts_again_at_its_speed() -> None:
    machine = declared(0.01)
    elapsed, shown = motion(machine, 17.0, 0.1, 60, np.random.default_rng(7))
    estimator = follower(machine)
    estimator.lose(LossCause.PAUSE)
    bits, off = offsets(estimator, elapsed, shown)
    assert bits[0] & LOST
    assert bits[-1] == VALID
    assert {one for one in off if one is not None} == {started_at(shown)}


@pytest.mark.parametrize("acceleration", [0.01, 0.05, 0.1])
@pytest.mark.parametrize("missed", [(1,), (2,), (2, 3), (3, 4), (4, 5, 6), (1, 3)])
def test_missed_samples_in_a_start_in_motion_make_no_wrong_position_valid(
    acceleration: float, missed: tuple[int, ...]
) -> None:
    """After a gap a window may hold several counts of a speed: all of them are followed."""
    machine = declared(acceleration)
    generator = np.random.default_rng(8)
    for _ in range(30):
        elapsed, shown = motion(machine, float(generator.uniform(-125.0, 125.0)), 0.1, 44, generator)
        _, off = offsets(follower(machine), elapsed, shown, missed)
        assert {one for one in off if one is not None} <= {started_at(shown)}


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
            search = SpeedHypotheses(BoundedMotion(0.198, machine.phase_error, TAU), machine.bad_samples)
            for n, position in enumerate(shown):
                search.feed(position % 1.0, elapsed[n] / unit)
                if n == 0 and limit is not None:
                    search.motion = BoundedMotion(limit, machine.phase_error, TAU)
            kept.append(search.holds(int(np.floor(shown[-1]))))
        assert all(kept) is (limit is not None)
