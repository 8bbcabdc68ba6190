"""The position after a gap, if it can be determined.

Phases determine place and speed after a gap except for whole cycles. These depend on
the acceleration of the machine meanwhile, which was not sampled. So the accelerations seen before and
after the gap bound those within: each trajectory through it needs them to spread over some width at
least. The one that needs the least is the position, if it needs hardly more than was seen, and
every other one far more.

With n intervals from the last place to the first sample after the gap, n + 1 accelerations w(j) are not
sampled. With the speed v before, the change of the speed q and the displacement d beyond v n are

    q = w(1) + ... + w(n + 1),    d = n w(1) + (n - 1) w(2) + ... + w(n)

Both are known up to whole cycles, from the phases. If all w(j) lie in an interval [a, b], q lies in
[(n + 1) a, (n + 1) b], and for a given q the displacement is least where the large accelerations come
last, and greatest where they come first. The width b - a that a passage needs is the smallest for
which q and d are possible. docs/fault-campaign.md shows what this finds and what it misses.

The last samples before the gap may have been bad already: a glitch of less than the residual
limit is seen one sample later only. So each trajectory is also sought from the places before these.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

# The following were chosen with the fault campaign (docs/fault-campaign.md): as wide as recoveries need, as
# narrow as silent wrong positions demand.
# What a machine may do in a gap beyond what was seen: cycles per interval squared, and a part of it.
SPARE_CYCLES = 0.01
SPARE_PART = 0.5
MOST_WIDTH = 0.11  # of all accelerations together: a machine that does more can do anything in a gap
# Any other trajectory must need this many times the width of the accelerations, and some more.
CLEARLY = 2.0
CLEARLY_CYCLES = 0.02
LAST_PLACES = 7  # that show the acceleration just before a gap
_BISECTIONS = 20


class Place(NamedTuple):
    """One accepted sample: cycle count, phase, and the intervals since the one before."""

    cycles: int
    phase: float
    elapsed: float


class Passage(NamedTuple):
    """A trajectory through a gap.

    cycles       cycle count of the first sample after it
    step_cycles  whole cycles from there to the second one, beyond the difference of their phases
    width        of the accelerations that it needs, cycles per interval squared
    """

    cycles: int
    step_cycles: int
    width: float


class Gap(NamedTuple):
    """A gap, and what was seen around it.

    intervals     sampling intervals from the last place before it to the first one after it
    displacement  cycles, beyond that at the speed before; whole cycles unknown
    speed_change  cycles per interval; whole cycles unknown
    low, high     least and greatest acceleration seen, cycles per interval squared
    """

    intervals: int
    displacement: float
    speed_change: float
    low: float
    high: float

    @property
    def width(self) -> float:
        """Width of the accelerations seen."""
        return self.high - self.low

    def through(self, low: float, high: float) -> Iterator[tuple[int, int]]:
        """Whole cycles to add to displacement and speed, for which accelerations from low to high suffice."""
        n = self.intervals + 1
        first = math.ceil(low * n - self.speed_change - 1e-9)
        last = math.floor(high * n - self.speed_change + 1e-9)
        for step in range(first, last + 1):
            least, most = self._displacements(low, high, self.speed_change + step)
            for cycles in range(
                math.ceil(least - self.displacement - 1e-9), math.floor(most - self.displacement + 1e-9) + 1
            ):
                yield cycles, step

    def needs(self, cycles: int, step: int, limit: float) -> float:
        """Width that accelerations need for this trajectory, at most ``limit``."""
        least, most = 0.0, (limit - self.width) / 2.0
        for _ in range(_BISECTIONS):
            middle = (least + most) / 2.0
            if self._passes(cycles, step, self.low - middle, self.high + middle):
                most = middle
            else:
                least = middle
        return self.width + 2.0 * most

    def _passes(self, cycles: int, step: int, low: float, high: float) -> bool:
        n = self.intervals + 1
        change = self.speed_change + step
        if not low * n - 1e-9 <= change <= high * n + 1e-9:
            return False
        least, most = self._displacements(low, high, change)
        return least - 1e-9 <= self.displacement + cycles <= most + 1e-9

    def _displacements(self, low: float, high: float, change: float) -> tuple[float, float]:
        """Least and greatest displacement with this change of speed.

        ``intervals + 1`` accelerations between ``low`` and ``high`` add up to the change. The
        first one counts ``intervals`` times in the displacement, the next once less, the last not at all.
        """
        n, width = self.intervals, high - low
        full = min(max((change - low * (n + 1)) / width, 0.0), n + 1.0) if width > 0.0 else 0.0
        base = low * n * (n + 1) / 2.0
        return base + width * _late(full), base + width * (full * n - _late(full))


def _late(full: float) -> float:
    """Displacement by ``full`` accelerations of 1, as late as possible: they count 0, 1, 2 ... times."""
    whole = math.floor(full)
    return whole * (whole - 1) / 2.0 + (full - whole) * whole


def bridge(
    before: Sequence[Place], run: Sequence[float], since: float, doubted: int, limit: float
) -> Passage | None:
    """The one trajectory from the places before a gap to the run after it; None unless there is just one.

    before   accepted places, oldest first, at least one: a machine with only one stood still
    run      phases of neighbouring samples after the gap, at least three
    since    intervals from the last of ``before`` to the first of ``run``
    doubted  this many of the last places may have been bad
    limit    residual limit: no acceleration is greater, cycles per interval squared
    """
    start = math.floor(before[-1].cycles + speed(before) * since)
    gaps = _gaps(before, run, since, doubted, start)
    widths: dict[tuple[int, int], float] = {}
    for gap in gaps:
        most = min(gap.width + 2.0 * (SPARE_CYCLES + SPARE_PART * gap.width), MOST_WIDTH)
        if gap.width >= most:
            continue
        for passage in gap.through(*_within(gap, most, limit)):
            widths[passage] = min(gap.needs(*passage, most), widths.get(passage, math.inf))
    if not widths:
        return None
    best = min(widths, key=lambda passage: widths[passage])
    enough = CLEARLY * widths[best] + CLEARLY_CYCLES
    for gap in gaps:
        if gap.width < enough and any(
            passage != best for passage in gap.through(*_within(gap, enough, limit))
        ):
            return None
    return Passage(start + best[0], best[1], widths[best])


def speed(places: Sequence[Place]) -> float:
    """Speed between the last two places, cycles per interval; 0 with only one."""
    return _speeds(places[-2:])[0] if len(places) > 1 else 0.0


def accelerations(places: Sequence[Place]) -> list[float]:
    """Between the places, oldest first, cycles per interval squared."""
    speeds = _speeds(places)
    times = [place.elapsed for place in places[1:]]
    return [
        2.0 * (new - old) / (earlier + later)  # a speed belongs to the middle of its interval
        for (old, new), (earlier, later) in zip(
            itertools.pairwise(speeds), itertools.pairwise(times), strict=True
        )
    ]


def run_accelerations(run: Sequence[float]) -> list[float]:
    """Between neighbouring samples, to the nearest whole cycle, cycles per interval squared."""
    bends = [new - 2.0 * middle + old for old, middle, new in zip(run, run[1:], run[2:], strict=False)]
    return [bend - round(bend) for bend in bends]


def roughness(seen: Sequence[float]) -> float:
    """How much accelerations change from sample to sample, but for the few greatest changes."""
    changes = sorted(abs(new - old) for old, new in itertools.pairwise(seen))
    return changes[len(changes) * 3 // 4] if changes else 0.0


def _speeds(places: Sequence[Place]) -> list[float]:
    return [
        ((new.cycles - old.cycles) + (new.phase - old.phase)) / new.elapsed
        for old, new in itertools.pairwise(places)
    ]


def _gaps(before: Sequence[Place], run: Sequence[float], since: float, doubted: int, start: int) -> list[Gap]:
    """The gap as it is if all places before it are good, and if the last ones are not."""
    seen = run_accelerations(run)
    made = []
    for count in range(max(0, min(doubted, len(before) - 2)) + 1):
        good = before[: len(before) - count]
        if count == 0 or _is_rough(before, count):
            made.append(
                _gap(good, run, since, start, [*seen, *(accelerations(good[-LAST_PLACES:]) or [0.0])])
            )
        since += good[-1].elapsed
    return made


def _gap(good: Sequence[Place], run: Sequence[float], since: float, start: int, seen: list[float]) -> Gap:
    last, old = good[-1], speed(good)
    return Gap(
        intervals=max(1, round(since)),
        displacement=(start - last.cycles) + (run[0] - last.phase) - old * since,
        speed_change=run[1] - run[0] - old,
        low=min(seen),
        high=max(seen),
    )


def _is_rough(before: Sequence[Place], count: int) -> bool:
    """Do the last ``count`` places leave the accelerations before, or are these unknown?

    Not if they all do so alike: then the machine has begun to accelerate.
    """
    seen = accelerations(before)
    older, newest, left = seen[:-count], seen[-count], seen[-count:]
    if len(older) < 2:
        return True
    if count > 1 and max(left) - min(left) <= SPARE_PART * roughness(older) + 2.0 * SPARE_CYCLES:
        return False
    last = older[2 - LAST_PLACES :]
    spare = SPARE_PART * (max(last) - min(last)) + SPARE_PART * roughness(older) + SPARE_CYCLES
    return not min(last) - spare <= newest <= max(last) + spare


def _within(gap: Gap, width: float, limit: float) -> tuple[float, float]:
    """Accelerations of this width around those seen, up to the limit."""
    beyond = (width - gap.width) / 2.0
    return max(gap.low - beyond, min(-limit, gap.low)), min(gap.high + beyond, max(limit, gap.high))
