"""Speeds and acceleration of a machine by its last samples, cycles and intervals; whether it stands still.

Whole cycles per interval show phases that stand still, too. With clocks 100 ppm apart they move by more
than 0.02 cycle in 256 samples; at any other speed they stay so near with a chance of 1.6e-4.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

STANDSTILL_CYCLES = 0.001  # per interval, on average: what noise and a servo at rest may show
STILL_SAMPLES, STILL_CYCLES = 256, 0.02
# What an error of a time may make of a phase at the speed of the machine, without a second opinion: with the
# residual limit of 1/3 it is less than half a cycle.
SLIP_CYCLES = 0.15
MOVED_CYCLES = 0.05  # what the errors of two phases do not show: twice the largest one, and once more as much
STEADY_SAMPLES = 16  # show whether the machine stands still

Place = tuple[int, float, float]  # cycle count, phase, intervals since the one before


def apart(phase: float, other: float) -> float:
    return (phase - other + 0.5) % 1.0 - 0.5  # the nearest way between them


def acceleration(places: Sequence[Place]) -> float:
    """Between the last three places, cycles per interval squared; 0 with fewer."""
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
    """So many places are known, ``least``, and over the last 16 the machine did not move, to nor fro."""
    recent = list(places)[-STEADY_SAMPLES:]
    moved = [(place[0] - recent[-1][0]) + (place[1] - recent[-1][1]) for place in recent]
    still = (
        abs(steady_speed(recent)) < STANDSTILL_CYCLES and max(map(abs, moved), default=0.0) <= STILL_CYCLES
    )
    return still and len(recent) >= least


def least_speed(places: Sequence[Place], steps: int) -> float:
    """The smallest speed of the last ``steps``, cycles per interval; 0 without one."""
    recent = list(places)[-steps - 1 :]
    speeds = [((new[0] - old[0]) + (new[1] - old[1])) / new[2] for old, new in itertools.pairwise(recent)]
    return min(speeds, key=abs, default=0.0)


class StillPhase:
    """Counts the samples in a row near one phase; ``phase`` is that of a machine that is known to stand.

    ``stays``: it is, and each sample since was near it.
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
