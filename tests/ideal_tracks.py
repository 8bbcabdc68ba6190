"""Samples of an ideal encoder, a correction table that no encoder needs, and stages without the short way."""

from __future__ import annotations

import math

import numpy as np

from canfb.signal.correction import CorrectionTable
from canfb.signal.sample import Feedback
from canfb.signal.stages import Stages


def counts_at(cycles: float, amplitude: float = 1500.0) -> tuple[int, int]:
    """Sine and cosine at this position, counts."""
    angle = 2.0 * math.pi * cycles
    return round(amplitude * math.sin(angle)), round(amplitude * math.cos(angle))


def wavy_table(entries: int = 64, amplitude: float = 0.01) -> CorrectionTable:
    """The identity with one sine wave over the cycle."""
    phases = np.arange(entries) / entries
    return CorrectionTable(phases + amplitude * np.sin(2.0 * np.pi * phases))


class Resolving(Stages):
    """Stages that take no sample for a usual one."""

    def _look_again(self, feedback: Feedback) -> None:
        super()._look_again(feedback)
        self._nothing_in_doubt = False
