"""What offset, gain and phase of the tracks are now, from samples over the whole cycle.

Behind the conditioning the tracks are z(x) = c + i s = sum z_k e^ikx. Offsets are z_0, gain and phase error
z_-1 = (-gain / 2 + i phase / 2) z_1. In the frame that turns with the phase, w = z e^-ix,

    z_0 = mean of (w - z_1) e^ix,      z_-1 = mean of (w - z_1) e^2ix

over an even phase: the means of 16 sectors. What changes after the calibration shows by half, for the phase
follows the tracks and only their radius tells it.
"""

from __future__ import annotations

import cmath
import math
from math import cos, sin
from typing import NamedTuple

import numpy as np

from canfb.signal.conditioning import HARMONIC_ORDERS
from canfb.signal.correction import Correction
from canfb.signal.phase import FloatArray

SECTORS = 16
FEWEST = 4  # samples in each sector
ROUNDS = 8  # each leaves a small part of what the first order has left
TURN = 2.0 * math.pi
# A mean over a sector is less than the value in its middle, by this factor.
LEFT_OF_FIRST, LEFT_OF_SECOND = (math.sin(m * math.pi / SECTORS) * SECTORS / (m * math.pi) for m in (1, 2))


class CircleDeviation(NamedTuple):
    """Of conditioned tracks from a circle about the origin, relative to the fundamental.

    ``offset`` is z_0, cosine + i sine, ``backward`` is z_-1.
    """

    offset: complex
    backward: complex


NO_DEVIATION = CircleDeviation(0j, 0j)


class SectorMeans(NamedTuple):
    """The deviation, and the mean amplitude in counts."""

    deviation: CircleDeviation
    amplitude_counts: float


class TrackSectors:
    """Takes samples until there are :data:`FEWEST` of them in each sector of the cycle."""

    __slots__ = ("_counts", "_filled", "_places", "_radial", "_tangential", "taken")

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        self.taken = self._filled = 0
        self._counts = [0] * SECTORS
        self._places, self._radial, self._tangential = ([0.0] * SECTORS for _ in range(3))

    def take(self, sine: float, cosine: float, phase: float) -> bool:
        """A sample: conditioned tracks in counts, corrected phase in cycles; True if no sector needs more."""
        angle = TURN * phase
        along, across = cos(angle), sin(angle)
        sector = int(phase * SECTORS)
        self._places[sector] += phase
        self._radial[sector] += cosine * along + sine * across
        self._tangential[sector] += sine * along - cosine * across
        self._counts[sector] = count = self._counts[sector] + 1
        if count == FEWEST:
            self._filled += 1
        self.taken += 1
        return self._filled == SECTORS

    def found(self) -> SectorMeans:
        rows = list(zip(self._counts, self._places, self._radial, self._tangential, strict=True))
        turning = [complex(radial, tangential) / n for n, _, radial, tangential in rows]
        turns = [cmath.exp(1j * TURN * place / n) for n, place, _, _ in rows]
        fundamental = sum(turning) / SECTORS
        rest = [one - fundamental for one in turning]
        offset = sum(one * turn for one, turn in zip(rest, turns, strict=True)) / SECTORS
        backward = sum(one * turn * turn for one, turn in zip(rest, turns, strict=True)) / SECTORS
        size = abs(fundamental)
        if not size:
            return SectorMeans(NO_DEVIATION, 0.0)
        return SectorMeans(
            CircleDeviation(
                offset / (LEFT_OF_FIRST * size), backward * fundamental / (LEFT_OF_SECOND * size * size)
            ),
            size,
        )


def deviation_of(correction: Correction) -> CircleDeviation | None:
    """Of the tracks at the reference measurement, with this correction; None: it does not tell.

    Without a table a circle. Of what a table corrects the harmonics (2005h) say what is z_-1, the rest is
    z_0.
    """
    table, conditioning = correction.table, correction.conditioning
    if table is None:
        return NO_DEVIATION
    if not any(conditioning.harmonics):
        return None
    places = (np.arange(8 * SECTORS) + 0.5) / (8 * SECTORS)
    raw = np.arange(len(table)) / len(table)
    phases = table.entries
    phase = np.concatenate((phases - 1.0, phases, phases + 1.0))
    angle = _angle(raw)
    removed = np.interp(places, phase, np.concatenate((angle - 1.0, angle, angle + 1.0))) - places
    turns = np.exp(1j * TURN * places)
    known = 1.0 + sum(
        one * turns ** (order - 1) for order, one in zip(HARMONIC_ORDERS, conditioning.harmonics, strict=True)
    )
    offset = 0j
    for _ in range(ROUNDS):
        left = TURN * removed - np.angle(known + offset / turns)
        offset += complex(np.mean(left / turns) * -2j).conjugate()
    return CircleDeviation(offset, conditioning.harmonics[0])


def _angle(raw: FloatArray) -> FloatArray:
    """Arc tangent of the tracks, cycles, at a raw phase: the inverse of Table 1."""
    octant = np.floor(4.0 * raw + 0.5)
    return np.asarray(octant / 4.0 + np.arctan(8.0 * (raw - octant / 4.0)) / TURN, np.float64)
