"""Which motions there are through given samples, by enumeration over small grids. No estimator is in it.

A motion of order r on a grid of q steps per cycle: whole numbers at successive instants whose r-th
differences are at most B q. Every one is listed, so what holds for all holds for each machine that moves so.
The oracles agree with each other, with the bounds of docs/supervision.md, and with the generator.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from math import comb

import numpy as np
import pytest

from tools.faults.samples.episodes import draw
from tools.faults.samples.kinds import KINDS, Declared, State
from tools.faults.samples.legal import LegalMotions, is_legal, least_bound, window

Motion = tuple[int, ...]


def next_of(motion: Sequence[int], order: int, bound: int) -> Iterator[int]:
    """Every next position, grid steps: ``bound`` around the one with no difference of this order."""
    centre = -sum((-1) ** n * comb(order, n) * motion[-n] for n in range(1, order + 1))
    return iter(range(centre - bound, centre + bound + 1))


def ends_through(
    known: Sequence[int], phases: Sequence[int | None], steps_per_cycle: int, order: int, bound: int
) -> set[int]:
    """Where the motions through ``known`` and these phases (None: any) are at the last instant.

    Motions with the same last positions have the same future: one of them stands for all.
    """
    lasts: set[Motion] = {tuple(known[-order:])}
    for phase in phases:
        lasts = {
            (*last[1:], position)
            for last in lasts
            for position in next_of(last, order, bound)
            if phase is None or position % steps_per_cycle == phase
        }
    return {last[-1] for last in lasts}


def all_motions(known: Sequence[int], samples: int, order: int, bound: int) -> Iterator[Motion]:
    """All that a machine can do in so many intervals that follow, with differences -B, 0 and B."""
    for differences in product((-bound, 0, bound), repeat=samples):
        motion = list(known)
        for one in differences:
            centre = -sum((-1) ** n * comb(order, n) * motion[-n] for n in range(1, order + 1))
            motion.append(centre + one)
        yield tuple(motion)


Q = 24  # grid steps per cycle


@pytest.mark.parametrize("missed", [1, 2, 3, 4, 5])
def test_a_whole_cycle_over_a_gap_takes_the_bound_of_the_proof(missed: int) -> None:
    """docs/supervision.md: one cycle more and the same speed; A + a = 1 / floor((n + 2)^2 / 4)."""
    at = np.array([0.0, 1.0, missed + 2.0, missed + 3.0])
    least = least_bound(at, np.array([0.0, 0.0, 1.0, 1.0]), 0.0, 2)
    assert least == pytest.approx(1.0 / ((missed + 2) ** 2 // 4))
    if missed == 2:  # the divided differences of the received samples alone are too loose
        assert least > 1.0 / 12.0 + 0.1


@pytest.mark.parametrize(
    ("order", "missed", "bound"), [(2, 1, 4), (2, 2, 3), (2, 3, 2), (3, 1, 2), (3, 2, 1)]
)
def test_every_motion_on_the_grid_is_legal_and_the_others_are_not(
    order: int, missed: int, bound: int
) -> None:
    """Enumeration against the linear program: the end counts of all motions over a gap are feasible ones.

    And a motion of the program is one of the grid where the bound has a grid step to spare.
    """
    known = [0] * order
    for phase in (0, 7, 12):
        phases = [None] * missed + [phase]
        found = ends_through(known, phases, Q, order, bound)
        at = np.array([*range(order), order + missed], float)
        for count in range(-3, 4):
            end = count + phase / Q
            samples = np.array([*np.zeros(order), end])
            least = least_bound(at, samples, 0.0, order) * Q
            if count * Q + phase in found:
                assert least <= bound + 1e-6, (phase, count)
            else:
                assert least > bound - 1, (phase, count)


@pytest.mark.parametrize("order", [2, 3])
def test_the_window_holds_every_next_position(order: int) -> None:
    bound = 3
    for motion in all_motions([0] * order, 4, order, bound):
        weights, reach = window([0.0, 1.0, 2.0][:order], float(order), 0.0, bound)
        centre = float(np.dot(weights, motion[:order]))
        assert abs(motion[order] - centre) <= reach + 1e-9


MACHINES = (
    Declared(0.01),
    Declared(0.1),
    Declared(0.2),
    Declared(0.05, samples_per_sync=3),
    Declared(0.05, 0.002),
)


@pytest.mark.parametrize("kind", [one for one in KINDS.values() if one.bad == 0], ids=lambda one: one.name)
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
        assert is_legal(at, samples, machine.phase_error, 2, machine.acceleration)
        motions = LegalMotions(machine.phase_error, 2, machine.acceleration)
        motions.begin(at[:4].tolist(), samples[:4].tolist())
        for instant, sample in zip(at[4:].tolist(), samples[4:].tolist(), strict=True):
            motions.add(instant, sample % 1.0)
            assert any(abs(path[-1] - sample) < 0.01 for path in motions.paths)
