"""Samples of an ideal encoder, a correction table that no encoder needs, and stages without the short way."""

import math
import struct

import numpy as np

from canfb import CorrectionTable, Feedback, Frame
from canfb.signal.stages import Stages


def counts_at(cycles: float, amplitude: float = 1500.0) -> tuple[int, int]:
    """Sine and cosine at this position, counts."""
    angle = 2.0 * math.pi * cycles
    return round(amplitude * math.sin(angle)), round(amplitude * math.cos(angle))


def adc_pdo(cycles: float, amplitude: float = 1500.0, time_s: float | None = None) -> Frame:
    """What the encoder interface 10h sends of this position; behind it its sample time, if there is one."""
    time = b"" if time_s is None else struct.pack("<I", round(time_s * 1e7) % 2**32)
    return Frame(0x190, struct.pack("<hh", *counts_at(cycles, amplitude)) + time)


def wavy_table(entries: int = 64, amplitude: float = 0.01) -> CorrectionTable:
    """The identity with one sine wave over the cycle."""
    phases = np.arange(entries) / entries
    return CorrectionTable(phases + amplitude * np.sin(2.0 * np.pi * phases))


class Resolving(Stages):
    """Stages that take no sample for a usual one."""

    def _look_again(self, feedback: Feedback) -> None:
        super()._look_again(feedback)
        self._usual_status = 0
