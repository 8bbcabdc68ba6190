"""A replay of any length in few numbers, for pictures: extremes of stretches of time, and some samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from canfb.objects import StatusBit
from canfb.replay.fault_list import KINDS
from canfb.replay.sample_columns import Block
from canfb.signal.phase import FloatArray

MOST_STRETCHES = 2048
STRETCH_ROWS = 16
MOST_SAMPLES = 16384
FAULTY = int(np.bitwise_or.reduce([int(bit) for bit in KINDS.values()]))

# What of a stretch is kept: the column, and how.
_KEPT: dict[str, tuple[str, Any]] = {
    "begin_s": ("time_s", np.minimum),
    "residual": ("residual", np.fmax),
    "residual_limit": ("residual_limit", np.minimum),
    "amplitude_least": ("amplitude_counts", np.fmin),
    "amplitude_most": ("amplitude_counts", np.fmax),
    "amplitude_low_counts": ("amplitude_low_counts", np.maximum),
    "amplitude_high_counts": ("amplitude_high_counts", np.minimum),
    "speed_least": ("speed_rad_s", np.fmin),
    "speed_most": ("speed_rad_s", np.fmax),
    "faults": ("faulty", np.add),
}


class Overview:
    """Give it blocks by :meth:`take`.

    ``stretches`` has, for each stretch: begin_s (stamp of the log), residual (the largest) and its limit,
    amplitude_least, amplitude_most and their limits (counts), speed_least, speed_most (rad/s), and faults
    (intervals with one). ``sine`` and ``cosine`` are ADC counts of some samples, evenly chosen.
    """

    def __init__(self) -> None:
        self.stretches: dict[str, FloatArray] = {name: np.empty(0) for name in _KEPT}
        self.sine, self.cosine = np.empty(0), np.empty(0)
        self._stride = 1

    def take(self, block: Block) -> None:
        """More samples."""
        columns = dict(block)
        came = block["status"] & StatusBit.MISSED == 0
        columns["faulty"] = (block["status"] & FAULTY != 0).astype(np.float64)
        columns["residual"] = np.where(came, block["residual"], np.nan)
        columns["amplitude_counts"] = np.where(came, block["amplitude_counts"], np.nan)
        columns["speed_rad_s"] = _speed(block)
        begins = np.arange(0, len(came), STRETCH_ROWS)
        for name, (column, how) in _KEPT.items():
            reduced = how.reduceat(columns[column].astype(np.float64), begins)
            self.stretches[name] = np.concatenate([self.stretches[name], reduced])
        while len(self.stretches["begin_s"]) > MOST_STRETCHES:
            self._merge()
        self._take_samples(block, came)

    def _merge(self) -> None:
        """Two stretches each become one."""
        pairs = np.arange(0, len(self.stretches["begin_s"]), 2)
        for name, (_, how) in _KEPT.items():
            self.stretches[name] = how.reduceat(self.stretches[name], pairs)

    def _take_samples(self, block: Block, came: npt.NDArray[np.bool_]) -> None:
        chosen = np.flatnonzero(came)[:: self._stride]
        self.sine = np.concatenate([self.sine, block["sine_counts"][chosen].astype(np.float64)])
        self.cosine = np.concatenate([self.cosine, block["cosine_counts"][chosen].astype(np.float64)])
        while len(self.sine) > MOST_SAMPLES:
            self.sine, self.cosine, self._stride = self.sine[::2], self.cosine[::2], 2 * self._stride


def _speed(block: Block) -> FloatArray:
    interval_s = np.where(block["interval_s"] > 0.0, block["interval_s"], np.nan)
    valid = block["status"] & StatusBit.VALID != 0
    speed = block["speed_cycles"] * 2.0 * np.pi / block["cycles_per_revolution"] / interval_s
    return np.where(valid, speed, np.nan)
