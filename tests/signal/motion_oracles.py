"""Which motions there are through given samples, by enumeration over small grids. No estimator is in it.

A motion of order r on a grid of q steps per cycle: whole numbers at successive instants whose r-th
differences are at most B q. Every one is listed, so what holds for all holds for each machine that moves so.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from math import comb

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
