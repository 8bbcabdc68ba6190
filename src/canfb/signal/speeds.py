"""Speed, acceleration and standstill of a machine by its last samples, in cycles and intervals.

At whole cycles per interval phases stand still, too. With clocks 100 ppm apart they move by more than 0.02
cycle in 256 samples; at any other speed they stay within that with a probability of 1.6e-4.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

STANDSTILL_CYCLES = 0.001  # per interval, on average: noise, and a servo at rest
STILL_SAMPLES, STILL_CYCLES = 256, 0.02
# Largest displacement by an error of a sampling instant that is accepted unchecked: with the residual limit
# of 1/3 it stays below half a cycle.
SLIP_CYCLES = 0.15
MOVED_CYCLES = 0.05  # a displacement beyond the errors of two phases: twice their sum of 0.025
STEADY_SAMPLES = 16  # the number of samples that show a standstill

Place = tuple[int, float, float]  # cycle count, phase, intervals since the one before


def apart(phase: float, other: float) -> float:
    return (phase - other + 0.5) % 1.0 - 0.5  # the shorter of both distances


def acceleration(places: Sequence[Place]) -> float:
    """Acceleration over the last three places, cycles per interval squared; 0 with fewer."""
    if len(places) < 3:
        return 0.0
    (c0, p0, _), (c1, p1, e1), (c2, p2, e2) = (places[n] for n in (-3, -2, -1))
    before, after = ((c1 - c0) + (p1 - p0)) / e1, ((c2 - c1) + (p2 - p1)) / e2
    return 2.0 * (after - before) / (e1 + e2)


def steady_speed(places: Sequence[Place]) -> float:
    """Mean speed over the last places, 16 at most, cycles per interval; 0 with fewer than two."""
    if len(places) < 2:
        return 0.0
    recent = list(places)[-STEADY_SAMPLES:]
    (cycles, phase, _), (last_cycles, last_phase, _) = recent[0], recent[-1]
    return ((last_cycles - cycles) + (last_phase - phase)) / sum(place[2] for place in recent[1:])


def stood_still(places: Sequence[Place], least: int = STEADY_SAMPLES) -> bool:
    """True if at least ``least`` places are known, and the machine did not move over the last 16."""
    recent = list(places)[-STEADY_SAMPLES:]
    moved = [(place[0] - recent[-1][0]) + (place[1] - recent[-1][1]) for place in recent]
    still = (
        abs(steady_speed(recent)) < STANDSTILL_CYCLES and max(map(abs, moved), default=0.0) <= STILL_CYCLES
    )
    return still and len(recent) >= least


def least_speed(places: Sequence[Place], steps: int) -> float:
    """The smallest speed of the last ``steps`` steps, cycles per interval; 0 without one."""
    recent = list(places)[-steps - 1 :]
    speeds = [((new[0] - old[0]) + (new[1] - old[1])) / new[2] for old, new in itertools.pairwise(recent)]
    return min(speeds, key=abs, default=0.0)


class StillPhase:
    """Counts ``samples`` in a row near one phase. ``phase``: that of a known standstill, if any.

    ``stays``: the standstill was known, and each sample since was near its phase.
    """

    __slots__ = ("_phase", "samples", "stays")

    def __init__(self, phase: float | None = None) -> None:
        self.stays = phase is not None
        self.samples = STILL_SAMPLES if self.stays else 0
        self._phase = math.nan if phase is None else phase

    def take(self, phase: float) -> None:
        """The next sample; ``phase`` 0..1, cycles."""
        if self.samples and abs(apart(phase, self._phase)) <= STILL_CYCLES:
            self.samples += 1
        else:
            self.samples, self._phase, self.stays = 1, phase, False
