"""The machine of the soak: it moves, rests, and is where it is at any time."""

from __future__ import annotations

import math
from dataclasses import dataclass

from canfb.signal.sample import Sample

AMPLITUDE_COUNTS = 1500.0
MOVE_S, REST_S = 1.4, 2.0
TOP_CYCLES_S = 20_000.0
TURN_S = 2.0 * (MOVE_S + REST_S)
MAX_ACCELERATION_CYCLES_S2 = TOP_CYCLES_S * math.pi / MOVE_S
MAX_JERK_CYCLES_S3 = MAX_ACCELERATION_CYCLES_S2 * 2.0 * math.pi / MOVE_S


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


@dataclass
class Machine:
    """A source of samples; remembers where the machine was at the last one.

    ``now`` is set by the world before each SYNC, seconds.
    """

    now: float = 0.0
    sampled_cycles: float = 0.0
    samples: int = 0

    def next(self) -> Sample:
        """The sample of this instant."""
        self.samples += 1
        self.sampled_cycles = position_cycles(self.now)
        angle = 2.0 * math.pi * (self.sampled_cycles % 1.0)
        return Sample(round(AMPLITUDE_COUNTS * math.sin(angle)), round(AMPLITUDE_COUNTS * math.cos(angle)))
