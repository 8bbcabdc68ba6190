"""The declared bound of a motion, and where the next sample can be within it.

A motion x(t), cycles, keeps the bound B if all its second divided differences, times 2, are at most B: its
acceleration, cycles per interval^2. A sample shows x(t) modulo one cycle, with an error of at most e =
phase error + instant error x |speed|.

**Window.** The line through the samples at t_1, t_2 misses x(t) by at most

    |x(t) - sum w_i x_i| <= B |t - t_1| |t - t_2| / 2 + e (1 + sum |w_i|),

w_i the weights of Lagrange: at equal intervals B + 4 e, the residual limit of eq. 9. After a short interval
the weights are large, and windows of the newest sample with older ones are narrower. All of them hold, so
they are intersected.

**Junction.** The samples before and after a hole belong to one motion. Nodes stand about one interval apart
where samples are missing. Each node, and each sample after the hole, is the extrapolation of the two nodes
before it plus a generator of size B prod / 2; each sample has another one of size e. So the deviations d of
two samples lie in a zonotope: |n d| <= sum |n g| over the normals n of its facets, perpendicular to each
generator.

Both conditions are necessary: no motion within the bound is ever excluded.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from canfb.signal.phase import FloatArray

ORDER = 2  # r samples determine the next one (eq. 9)
MOST_NODES = 32  # nodes in a hole; in a longer one they are further apart, and the junction is wider
SHORT_INTERVAL = 0.75  # below it the weights of eq. 9 are above 2.3 and 1.3: older samples are used, too
HOLE_INTERVALS = 1.5  # from this interval on, samples are missing between two
# An interval up to this may also be due to jitter of SYNC: at 0.1 interval rms one in 5000 is longer than
# 1.5, one in 17 million longer than this. If the window has one count only, that is right in any case.
LONG_INTERVAL = 1.75
BASELINES = 5  # samples that are used after a short interval
ROUNDING_CYCLES = 1e-9  # error of the arithmetic here, below any phase error


class Spot(NamedTuple):
    """A sample on a trajectory: time in intervals, cycle count, phase, error beyond the phase error."""

    time: float
    cycles: int
    phase: float
    error: float = 0.0


class Window(NamedTuple):
    """Where a sample can be: ``low`` .. ``high``, cycles from the cycle count ``base``."""

    base: int
    low: float
    high: float

    @property
    def width(self) -> float:
        return max(0.0, self.high - self.low)

    def counts(self, phase: float) -> range:
        if not -math.inf < self.low <= self.high < math.inf:
            return range(0)
        first = math.ceil(self.low - phase - ROUNDING_CYCLES)
        last = math.floor(self.high - phase + ROUNDING_CYCLES)
        return range(self.base + first, self.base + last + 1)


@dataclass(frozen=True)
class BoundedMotion:
    """``largest`` acceleration, cycles per interval^2; errors: of a phase, cycles, of a sampling instant,
    intervals.
    """

    largest: float
    phase_error: float
    instant_error: float = 0.0

    def error(self, spots: tuple[Spot, ...]) -> float:
        if not self.instant_error or len(spots) < 2:
            return self.phase_error
        before, last = spots[-2:]
        displacement = (last.cycles - before.cycles) + (last.phase - before.phase)
        return self.phase_error + self.instant_error * abs(displacement / (last.time - before.time))

    def window(self, spots: tuple[Spot, ...], time: float) -> Window:
        """Where a sample at ``time`` can be after two or more ``spots``, the newest last."""
        error = self.error(spots)
        low, high = -math.inf, math.inf
        short = abs(spots[-1].time - spots[-2].time) < SHORT_INTERVAL
        for older in spots[-BASELINES:-1] if short else spots[-ORDER:-1]:
            centre, radius = self._extrapolation((older, spots[-1]), time, error)
            low, high = max(low, centre - radius), min(high, centre + radius)
        return Window(spots[-1].cycles, low, high)

    def beyond(self, before: tuple[Spot, ...], run: tuple[Spot, ...], time: float) -> Window:
        """Where a sample at ``time`` can be; the hole is between ``before`` and ``run``, 0 or 1 samples."""
        error = self.error(before)
        known = before[-ORDER:]
        base, zero = known[-1].cycles, known[-1].time
        slopes, limits = junction(
            self.largest,
            tuple(round(spot.time - zero, 9) for spot in known),
            tuple(round(one - zero, 9) for one in (*(spot.time for spot in run), time)),
            tuple(error + spot.error for spot in known),
            error,
        )
        away = sum(
            (spot.cycles - base) + spot.phase - self._extrapolation(known, spot.time, error)[0]
            for spot in run
        )
        centre, _ = self._extrapolation(known, time, error)
        least, most = (slopes * away - limits).max(), (slopes * away + limits).min()
        return Window(base, centre + float(least), centre + float(most))

    def _extrapolation(self, spots: tuple[Spot, ...], time: float, error: float) -> tuple[float, float]:
        """Centre (relative to the cycle count of the newer of two ``spots``) and radius of the window."""
        times = tuple(spot.time for spot in spots)
        factors, base = weights(times, time), spots[-1].cycles
        centre = sum(w * ((spot.cycles - base) + spot.phase) for w, spot in zip(factors, spots, strict=True))
        spread = sum(abs(w) * (error + spot.error) for w, spot in zip(factors, spots, strict=True))
        return centre, self.largest * scale(times, time) + error + spread


def weights(times: Sequence[float], time: float) -> tuple[float, float]:
    """Lagrange weights of the values at two ``times`` in the extrapolation to ``time``."""
    ratio = (time - times[1]) / (times[1] - times[0])
    return -ratio, 1.0 + ratio


def scale(times: Sequence[float], time: float) -> float:
    """prod |time - t_i| / r!: factor of the bound B at ``time``."""
    return abs(time - times[0]) * abs(time - times[1]) / 2.0


@lru_cache(maxsize=512)
def junction(
    largest: float,
    before: tuple[float, ...],
    behind: tuple[float, ...],
    errors: tuple[float, ...],
    error: float,
) -> tuple[FloatArray, FloatArray]:
    """Slopes and limits of the facets, for the last of one or two samples at the times ``behind`` the hole.

    ``before`` and ``errors`` are the times and errors of the two samples before it, ``error`` that of each
    sample behind it.
    """
    gap = behind[0] - before[-1]
    nodes = min(max(0, round(gap) - 1), MOST_NODES)
    between = [before[-1] + gap * (n + 1) / (nodes + 1) for n in range(nodes)]
    times = [*before, *between, *behind]
    new = range(ORDER, len(times))
    rows = np.diag([*errors, *(largest * scale(times[n - ORDER : n], times[n]) for n in new)])
    for n in new:
        rows[n] += weights(times[n - ORDER : n], times[n]) @ rows[n - ORDER : n]
    generators = np.hstack([rows[-len(behind) :], error * np.eye(len(behind))])
    if len(behind) == 1:
        return np.zeros(1), np.abs(generators).sum(axis=1)
    # Perpendicular to (a, b): |a d_2 - b d_1| <= sum |a b' - b a'|. Those with a = 0 limit d_1 alone.
    first, last = generators[:, generators[0] != 0.0]
    slopes = last / first
    return slopes, np.abs(generators[1] - slopes[:, None] * generators[0]).sum(axis=1)
