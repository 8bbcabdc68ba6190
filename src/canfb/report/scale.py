"""From values to places on a picture: scales with round ticks."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from canfb.signal.phase import FloatArray

TICK_COUNT = 5
FEWER = 0.8  # of a step: rather seven ticks than three


class Scale:
    """From values to places on the picture, linear or logarithmic (base 10)."""

    def __init__(self, low: float, high: float, start: float, stop: float, log: bool = False) -> None:
        if not high > low:
            high = low + (abs(low) or 1.0)
        self.low, self.high, self.log = low, high, log
        self._start, self._stop = start, stop

    def __call__(self, value: float) -> float:
        """The place, held within a margin of the picture."""
        if self.log:
            part = math.log10(max(value, self.low) / self.low) / math.log10(self.high / self.low)
        else:
            part = (value - self.low) / (self.high - self.low)
        return self._start + min(max(part, -0.02), 1.02) * (self._stop - self._start)

    def ticks(self) -> list[float]:
        """Round values."""
        if self.log:
            first, last = math.ceil(math.log10(self.low) - 1e-9), math.floor(math.log10(self.high) + 1e-9)
            return [10.0**power for power in range(first, last + 1)]
        rough = (self.high - self.low) / TICK_COUNT
        power = 10.0 ** math.floor(math.log10(rough))
        step = next(one * power for one in (1.0, 2.0, 2.5, 5.0, 10.0) if one * power >= rough * FEWER)
        first = math.ceil(self.low / step - 1e-9)
        return [n * step for n in range(first, math.floor(self.high / step + 1e-9) + 1)]


def nice_limit(values: Sequence[float] | FloatArray, least: float = 0.0) -> float:
    """A little more than the largest size of the values that are numbers, at least ``least``."""
    sizes = np.abs(np.asarray(values, np.float64))
    sizes = sizes[np.isfinite(sizes)]
    return max(1.1 * float(sizes.max()) if len(sizes) else 0.0, least, 1e-12)


def tick_words(value: float) -> str:
    """A tick in few characters."""
    if value == 0.0:
        return "0"
    if 1e-4 <= abs(value) < 1e5:
        return f"{value:.6g}"
    power = math.floor(math.log10(abs(value)) + 1e-9)
    return f"{value / 10.0**power:.3g}e{power}"
