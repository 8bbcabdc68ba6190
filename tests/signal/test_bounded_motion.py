"""Windows and junctions hold every legal sample, and no more: against a linear program.

The linear program (tools/faults/samples/judge.py) shares nothing with the estimator. It agrees with another
oracle, the enumeration of all motions over small grids, with the bounds of docs/supervision.md, and with the
generator of the campaigns.
"""

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
import pytest

from canfb.signal.bounded_motion import BoundedMotion, Spot, Window
from tools.faults.machine import positions
from tools.faults.samples.episodes import KINDS, Declared, State, draw
from tools.faults.samples.judge import LegalMotions, is_legal, least_bound, window

TRIALS = 30
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


def true_samples(rng: np.random.Generator, at: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """A motion within the bound at these instants, with errors up to ``errors``; whole speeds, too."""
    extreme = rng.uniform() < 0.5
    u = rng.choice((-1.0, 1.0), (1, 20)) if extreme else rng.uniform(-1.0, 1.0, (1, 20))
    speed = np.array([rng.uniform(-30.0, 30.0)])
    truth = positions(BOUND * u, speed, rng, at[None, :] + 3.0)[0]
    part = rng.choice((-1.0, 1.0), len(at)) if extreme else rng.uniform(-1.0, 1.0, len(at))
    return np.asarray(truth + part * errors)


def spots_of(at: np.ndarray, samples: np.ndarray, errors: np.ndarray, phase_error: float) -> tuple[Spot, ...]:
    whole = np.floor(samples).astype(int)
    return tuple(
        Spot(float(t), int(i), float(x - i), float(e - phase_error))
        for t, i, x, e in zip(at, whole, samples, errors, strict=True)
    )


@pytest.mark.parametrize("start_error", [0.0, 0.05])
@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("missed", [0, 1, 2, 5])
@pytest.mark.parametrize("k", [1, 2])
def test_a_junction_has_every_legal_sample_and_ends_at_the_bound(
    k: int, missed: int, uneven: bool, start_error: float
) -> None:
    """At either end of the window the least bound of a motion through all samples is the one declared."""
    rng = np.random.default_rng([k, missed, uneven])
    for trial in range(TRIALS):
        at = instants_of(rng, k, uneven, missed)
        errors = np.full(len(at), MOTION.phase_error)
        errors[0] += start_error
        samples = true_samples(rng, at, errors)
        spots = spots_of(at, samples, errors, MOTION.phase_error)
        window = MOTION.beyond(spots[:2], spots[2:-1], float(at[-1]))
        low, high = window.base + window.low, window.base + window.high
        assert low - 1e-9 <= samples[-1] <= high + 1e-9
        assert spots[-1].cycles in window.counts(spots[-1].phase)
        if trial < 8:
            for end in (low, high):
                through = np.append(samples[:-1], end)
                assert least_bound(at, through, errors) == pytest.approx(BOUND, abs=1e-6)


@pytest.mark.parametrize("uneven", [False, True])
def test_a_window_has_every_legal_sample(uneven: bool) -> None:
    """Of a run without a hole, also behind short intervals, where several baselines are asked."""
    rng = np.random.default_rng(int(uneven))
    for trial in range(4 * TRIALS):
        apart = rng.uniform(0.1, 1.5, 7) if uneven else np.ones(7)
        at = np.concatenate(([0.0], np.cumsum(apart)))
        errors = np.full(len(at), MOTION.phase_error)
        samples = true_samples(rng, at, errors)
        spots = spots_of(at, samples, errors, MOTION.phase_error)
        window = MOTION.window(spots[:-1], float(at[-1]))
        low, high = window.base + window.low, window.base + window.high
        assert low - 1e-9 <= samples[-1] <= high + 1e-9
        if not uneven and trial < 8:  # the last r samples: the residual limit
            assert window.width == pytest.approx(2.0 * (BOUND + 4.0 * MOTION.phase_error))
            last = slice(-3, None)
            for end in (low, high):
                through = np.append(samples[:-1], end)[last]
                least = least_bound(at[last], through, MOTION.phase_error)
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


def test_an_empty_window_has_no_count() -> None:
    empty = Window(0, 0.5, 0.25)
    assert list(empty.counts(0.3)) == []
    assert empty.width == 0.0


# A motion on a grid of q steps per cycle: whole numbers at successive instants whose second
# differences are at most B q. Every one is listed: what holds for all holds for each machine that moves so.
Motion = tuple[int, ...]


def centre_of(motion: Sequence[int]) -> int:
    """The next position, grid steps, at the same speed."""
    return 2 * motion[-1] - motion[-2]


def ends_through(
    known: Sequence[int], phases: Sequence[int | None], steps_per_cycle: int, bound: int
) -> set[int]:
    """Where the motions through ``known`` and these phases (None: any) are at the last instant.

    Motions with the same last positions have the same future: one of them stands for all.
    """
    lasts: set[Motion] = {tuple(known[-2:])}
    for phase in phases:
        lasts = {
            (*last[1:], position)
            for last in lasts
            for position in range(centre_of(last) - bound, centre_of(last) + bound + 1)
            if phase is None or position % steps_per_cycle == phase
        }
    return {last[-1] for last in lasts}


def all_motions(known: Sequence[int], samples: int, bound: int) -> Iterator[Motion]:
    """All that a machine can do in so many intervals that follow, with differences -B, 0 and B."""
    for differences in product((-bound, 0, bound), repeat=samples):
        motion = list(known)
        for one in differences:
            motion.append(centre_of(motion) + one)
        yield tuple(motion)


Q = 24  # grid steps per cycle


@pytest.mark.parametrize("missed", [1, 2, 3, 4, 5])
def test_a_whole_cycle_over_a_gap_takes_the_bound_of_the_proof(missed: int) -> None:
    """docs/supervision.md: one cycle more and the same speed; A + a = 1 / floor((n + 2)^2 / 4)."""
    at = np.array([0.0, 1.0, missed + 2.0, missed + 3.0])
    least = least_bound(at, np.array([0.0, 0.0, 1.0, 1.0]), 0.0)
    assert least == pytest.approx(1.0 / ((missed + 2) ** 2 // 4))
    if missed == 2:  # the divided differences of the received samples alone are too loose
        assert least > 1.0 / 12.0 + 0.1


@pytest.mark.parametrize(("missed", "bound"), [(1, 4), (2, 3), (3, 2)])
def test_every_motion_on_the_grid_is_legal_and_the_others_are_not(missed: int, bound: int) -> None:
    """Enumeration against the linear program: the end counts of all motions over a gap are feasible ones.

    And a motion of the program is one of the grid where the bound has a grid step to spare.
    """
    for phase in (0, 7, 12):
        found = ends_through([0, 0], [None] * missed + [phase], Q, bound)
        at = np.array([0.0, 1.0, 2.0 + missed])
        for count in range(-3, 4):
            end = count + phase / Q
            samples = np.array([0.0, 0.0, end])
            least = least_bound(at, samples, 0.0) * Q
            if count * Q + phase in found:
                assert least <= bound + 1e-6, (phase, count)
            else:
                assert least > bound - 1, (phase, count)


def test_the_window_holds_every_next_position() -> None:
    bound = 3
    for motion in all_motions([0, 0], 4, bound):
        weights, reach = window([0.0, 1.0], 2.0, 0.0, bound)
        centre = float(np.dot(weights, motion[:2]))
        assert abs(motion[2] - centre) <= reach + 1e-9


MACHINES = (
    Declared(0.01),
    Declared(0.1),
    Declared(0.2),
    Declared(0.05, samples_per_sync=3),
    Declared(0.05, 0.002),
)


@pytest.mark.parametrize("kind", [pytest.param(one, id=name) for name, one in KINDS.items() if one.bad == 0])
@pytest.mark.parametrize("machine", MACHINES, ids=str)
def test_the_true_motion_is_a_legal_one(kind, machine: Declared) -> None:
    """Of the whole episode: the generator keeps what is declared, and the judge never drops the truth."""
    if machine.samples_per_sync > 1 and (kind.jitter or kind.stall):
        pytest.skip("uneven instants are those of one sample for each SYNC")
    for episode in draw(kind, machine, 2, np.random.default_rng(24)):
        received = ~np.isin(episode.state, (State.MISSING, State.FLAGGED))
        right = episode.phase + np.rint(episode.truth - episode.phase)
        assert np.abs(right - episode.truth)[received].max() < machine.phase_error
        part = slice(max(0, episode.fault - 6), episode.fault + 14)
        at, samples = episode.instants[part][received[part]], right[part][received[part]]
        assert is_legal(at, samples, machine.phase_error, machine.acceleration)
        motions = LegalMotions(machine.phase_error, machine.acceleration)
        motions.begin(at[:4].tolist(), samples[:4].tolist())
        for instant, sample in zip(at[4:].tolist(), samples[4:].tolist(), strict=True):
            motions.add(instant, sample % 1.0)
            assert any(abs(path[-1] - sample) < 0.01 for path in motions.paths)
