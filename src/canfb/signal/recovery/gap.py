"""Which trajectories pass through a gap of missed samples, all samples around it being good.

The phases before and after a gap of n samples leave two whole numbers open: the cycles passed in
it, and the cycles per interval by which the speed changed. The n + 2 accelerations that were not sampled
decide them, and they have two known sums. A trajectory fits if accelerations within given bounds
have these sums. docs/missed-samples.md derives when only one fits.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

# What errors of the phase may do to the change of the speed over a gap, cycles per interval: four phases
# are in it, each with an error of an uncorrected encoder. See PHASE_ERROR_MARGIN_CYCLES of the limits.
CHANGE_MARGIN = 0.05


class Unseen(NamedTuple):
    """What is known of a gap.

    intervals  sampling intervals from the last sample before it to the first one after it
    displacement  cycles, beyond that at the speed before; whole cycles unknown
    change     of the speed, cycles per interval; whole cycles unknown. NaN with one sample after the gap
    uneven     by how much the samples around it are not one interval apart, intervals
    off        by how much longer the gap is than ``intervals``; negative where it is shorter
    """

    intervals: int
    displacement: float
    change: float
    uneven: float = 0.0
    off: float = 0.0


class Bounds(NamedTuple):
    """Of each unseen acceleration, oldest first, cycles per interval squared; ``intervals + 1`` of them.

    ``margin``: by how much the change of the speed may leave what they allow, cycles per interval.
    """

    low: list[float]
    high: list[float]
    margin: float


class Likeness(NamedTuple):
    """How much like those around it the accelerations in a gap are taken to be.

    beyond        they leave the range of those seen by this much, cycles per interval squared; and by
    per_change    this many times the greatest change seen, but not
    most_beyond   by more than that
    change_factor  they change from one to the next by this many times the greatest change seen
    change        and this much more
    margin        see :class:`Bounds`
    """

    beyond: float
    per_change: float
    most_beyond: float
    change_factor: float
    change: float
    margin: float


# A trajectory that is ALIKE is taken if no other one is even REMOTELY alike.
ALIKE = Likeness(0.01, 0.5, 0.03, 1.1, 0.02, 0.005)
REMOTELY = Likeness(0.035, 0.0, 0.035, 1.15, 0.025, 0.01)
EITHER_WAY = REMOTELY._replace(beyond=1.0, most_beyond=1.0)  # up to the limit
SLIGHT = 0.01  # cycles per interval squared: noise
SUDDEN = 0.04  # a change of the acceleration from one sample to the next
MORE = 1.2  # times what was seen


def within(limit: float, intervals: int, margin: float = CHANGE_MARGIN) -> Bounds:
    """Accelerations of any kind up to ``limit``, which may change at will."""
    unseen = intervals + 1
    return Bounds([-limit] * unseen, [limit] * unseen, margin)


def sure_acceleration(intervals: int) -> float:
    """Whatever accelerations up to this one do in the gap: no two trajectories have the same phases."""
    unseen = intervals + 1
    return 0.5 / max(unseen, unseen * unseen // 4)


def like(
    before: Sequence[float], after: Sequence[float], intervals: int, limit: float, how: Likeness
) -> Bounds:
    """Accelerations like those seen ``before`` and ``after`` the gap, at least one each, up to ``limit``."""
    seen = [*before, *after]
    # Once in the gap the machine may go straight from the last one before to the first one after it.
    change = _greatest_change(seen)
    beyond = min(how.beyond + how.per_change * change, how.most_beyond)
    change = how.change_factor * change + how.change
    bounds = Bounds([], [], how.margin)
    for k in range(intervals + 1):
        since, until = (k + 1) * change, (intervals + 1 - k) * change
        bounds.low.append(max(min(seen) - beyond, before[-1] - since, after[0] - until, -limit))
        bounds.high.append(min(max(seen) + beyond, before[-1] + since, after[0] + until, limit))
    return bounds


def fitting(unseen: Unseen, bounds: Bounds) -> list[tuple[int, int]]:
    """Whole cycles to add to displacement and change, for which accelerations within ``bounds`` suffice."""
    low, high, margin = bounds
    if any(least > most for least, most in zip(low, high, strict=True)):
        return []
    found: list[tuple[int, int]] = []
    # In a shorter gap no acceleration at first makes up for the rest, where there may be none.
    may_rest = max(low) <= 0.0 <= min(high)
    uneven = unseen.uneven + (max(unseen.off, 0.0) if may_rest else abs(unseen.off))
    margin += max(*map(abs, low), *map(abs, high)) * (unseen.intervals + 1) * uneven
    displacement_margin = margin * (unseen.intervals + 1) / 2.0
    for step in _whole(sum(low) - margin - unseen.change, sum(high) + margin - unseen.change):
        least, most = _displacements(low, high, unseen.change + step)
        cycles = _whole(
            least - displacement_margin - unseen.displacement,
            most + displacement_margin - unseen.displacement,
        )
        found.extend((cycle, step) for cycle in cycles)
    return found


def alike(
    unseen: Unseen, before: Sequence[float], after: Sequence[float], limit: float, known: bool
) -> tuple[int, int] | None:
    """The one trajectory of :func:`fitting` that is like what was seen; None if it is unclear.

    ``before`` and ``after`` the gap: accelerations, at least one each. ``limit``: none is greater;
    ``known``: the machine can do as much.
    """
    intervals, seen = unseen.intervals, [*before, *after]
    most, sure = max(map(abs, seen)), sure_acceleration(intervals)
    how = like(before, after, intervals, limit, REMOTELY)
    if most > sure + (-3.0 if known else 1.0) * SLIGHT and _greatest_change(seen) > SUDDEN:
        # Hard and sudden accelerations were seen: the gap may hold the same, in either direction.
        if intervals == 2 and abs(after[0] - before[-1]) <= ALIKE.most_beyond:
            how = like(before, after, intervals, min(most + REMOTELY.beyond, limit), EITHER_WAY)
        else:
            how = within(min(MORE * most + REMOTELY.beyond, limit), intervals, REMOTELY.margin)
    possible = fitting(unseen, how)
    if len(possible) != 1 or not fitting(unseen, like(before, after, intervals, limit, ALIKE)):
        return None
    if most <= sure + SLIGHT and any(
        other != possible[0]
        for other in fitting(unseen, within(sure - 2.0 * SLIGHT, intervals, ALIKE.margin))
    ):
        return None
    return possible[0]


def _greatest_change(seen: Sequence[float]) -> float:
    return max(abs(new - old) for old, new in itertools.pairwise(seen))


def passed(unseen: Unseen, limit: float) -> list[int]:
    """The whole cycles to add to the displacement, for any change of speed; accelerations up to ``limit``."""
    n = unseen.intervals
    margin = CHANGE_MARGIN + limit * (n + 1) * (unseen.uneven + max(unseen.off, 0.0))
    most = (limit * n + margin) * (n + 1) / 2.0
    return list(_whole(-most - unseen.displacement, most - unseen.displacement))


def _whole(low: float, high: float) -> range:
    return range(math.ceil(low), math.floor(high) + 1)


def _displacements(low: Sequence[float], high: Sequence[float], change: float) -> tuple[float, float]:
    """Least and greatest displacement by accelerations that add up to ``change``, as nearly as they can.

    The first one counts once less than there are accelerations, the next once less, the last not at all.
    """
    weights = range(len(low) - 1, -1, -1)
    base = sum(weight * least for weight, least in zip(weights, low, strict=True))
    rooms = [most - least for least, most in zip(low, high, strict=True)]
    above = min(max(change - sum(low), 0.0), sum(rooms))
    early = list(zip(weights, rooms, strict=True))
    return base + _filled(reversed(early), above), base + _filled(early, above)


def _filled(order: Iterable[tuple[int, float]], above: float) -> float:
    total = 0.0
    for weight, room in order:
        part = min(room, above)
        total += weight * part
        above -= part
    return total
