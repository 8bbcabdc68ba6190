"""Samples of an ideal encoder."""

from __future__ import annotations

import math


def counts_at(cycles: float, amplitude: float = 1500.0) -> tuple[int, int]:
    """Sine and cosine at this position, counts."""
    angle = 2.0 * math.pi * cycles
    return round(amplitude * math.sin(angle)), round(amplitude * math.cos(angle))
