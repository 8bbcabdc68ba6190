"""The machine of the soak: it moves, rests, and is where it is at any time."""

from __future__ import annotations

import math

from canfb.signal.sample import Sample
from canfb.sources.protocol import SourceError

AMPLITUDE_COUNTS = 1500.0
MOVE_S, REST_S = 1.4, 2.0
TOP_CYCLES_S = 20_000.0
TURN_S = 2.0 * (MOVE_S + REST_S)
MAX_ACCELERATION_CYCLES_S2 = TOP_CYCLES_S * math.pi / MOVE_S


def position_cycles(time_s: float) -> float:
    """To and fro, with a rest at either end: v = top / 2 (1 - cos(2 pi t / MOVE_S))."""
    within = time_s % TURN_S
    back = within >= MOVE_S + REST_S
    t = min(within - (MOVE_S + REST_S if back else 0.0), MOVE_S)
    way = TOP_CYCLES_S / 2.0 * (t - MOVE_S / (2.0 * math.pi) * math.sin(2.0 * math.pi * t / MOVE_S))
    whole = TOP_CYCLES_S / 2.0 * MOVE_S
    return 0.3 + (whole - way if back else way)


def rests(time_s: float, spare_s: float = 0.0) -> bool:
    """Whether it stands still from now until ``spare_s`` later."""
    within = time_s % (MOVE_S + REST_S)
    return within >= MOVE_S and within + spare_s < MOVE_S + REST_S


def is_fast(time_s: float) -> bool:
    """Whether it moves fast, and does so for a while."""
    return 0.3 <= time_s % (MOVE_S + REST_S) <= 0.4


class Machine:
    """A source of samples; remembers where the machine was at the last one.

    ``coarse``: the samples have a track with one cycle per revolution of ``cycles_per_revolution``, too.
    ``broken``: the converter gives nothing.
    """

    def __init__(self, cycles_per_revolution: int, *, coarse: bool = False) -> None:
        self._per_revolution = cycles_per_revolution
        self._coarse = coarse
        self.broken = False
        self.sampled_cycles = 0.0

    def sample_at(self, now: float) -> Sample:
        if self.broken:
            raise SourceError("the converter does not answer")
        self.sampled_cycles = position = position_cycles(now)
        sine, cosine = _tracks(position)
        if not self._coarse:
            return Sample(sine, cosine)
        coarse_sine, coarse_cosine = _tracks(position / self._per_revolution)
        return Sample(sine, cosine, coarse_sine=coarse_sine, coarse_cosine=coarse_cosine)

    def next(self) -> Sample:
        """Not asked: the interface knows when it samples."""
        raise NotImplementedError


def _tracks(position: float) -> tuple[int, int]:
    angle = 2.0 * math.pi * (position % 1.0)
    return round(AMPLITUDE_COUNTS * math.sin(angle)), round(AMPLITUDE_COUNTS * math.cos(angle))
