"""Samples of an ideal encoder, and a correction table that no encoder needs."""

from __future__ import annotations

import math

import numpy as np

from canfb.signal.correction import CorrectionTable


def counts_at(cycles: float, amplitude: float = 1500.0) -> tuple[int, int]:
    """Sine and cosine at this position, counts."""
    angle = 2.0 * math.pi * cycles
    return round(amplitude * math.sin(angle)), round(amplitude * math.cos(angle))


def wavy_table(entries: int = 64, amplitude: float = 0.01) -> CorrectionTable:
    """The identity with one sine wave over the cycle."""
    phases = np.arange(entries) / entries
    return CorrectionTable(phases + amplitude * np.sin(2.0 * np.pi * phases))
