"""The coupling between motor and encoder: it may slip, once."""

from __future__ import annotations

import math
from dataclasses import dataclass

SLIP_S = 0.5  # it begins and ends gently, so that the tracks of the encoder show nothing of it


@dataclass(frozen=True)
class Coupling:
    """From ``at_s`` of the time of the machine on the encoder falls behind by ``revolutions``, in 0.5 s."""

    revolutions: float = 0.0
    at_s: float = 0.0

    def slipped(self, time_s: float) -> float:
        """How far it has slipped by this time of the machine, revolutions."""
        part = min(1.0, max(0.0, (time_s - self.at_s) / SLIP_S))
        return self.revolutions * (1.0 - math.cos(math.pi * part)) / 2.0
