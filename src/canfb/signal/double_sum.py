"""The double cumulative sum of eq. 9 over an array.

numpy takes a running sum one sample after the other, each waiting for the one before, and two
of them took a third of the time of the whole array path. Here a matrix product adds up rows of
16 samples side by side, and running sums are left from row to row only.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from canfb.signal.blocks import Scratch
from canfb.signal.phase import FloatArray

ROW = 16
_PLACES = np.arange(1.0, ROW + 1.0)
# A turn at one place of a row is in the step, and so in each later count once more: at a later
# place it counts as often as the places are apart, and once.
_TURN_COUNTS = np.maximum(0.0, _PLACES - _PLACES[:, np.newaxis] + 1.0)
# The step before a row counts at each of its places, the cycle count before it is there once.
_BEFORE_COUNTS = np.array([_PLACES, np.ones(ROW)])
EXACT = 1 << 52  # integers of this size are exact in float64, and so are sums of a few


def cycle_counts(
    turns: FloatArray, cycles: int, step: int, out: npt.NDArray[np.int64], scratch: Scratch
) -> int:
    """Add up step(k) = step(k-1) + turns(k), i(k) = i(k-1) + step(k), i into ``out``; the last step.

    ``cycles`` and ``step`` are i and step before the first of ``turns``, which are whole and at
    most 2 in size. Exact; ``scratch.a`` and ``scratch.index`` are overwritten.
    """
    head = len(turns) // ROW * ROW
    if abs(cycles) + abs(step) * head >= EXACT:
        head = 0
    if head:
        cycles, step = _in_rows(turns[:head], cycles, step, out[:head], scratch)
    if head == len(turns):
        return step
    steps = scratch.index[: len(turns) - head]
    steps[:] = turns[head:]
    steps[0] += step
    np.add.accumulate(steps, out=steps)
    step = int(steps[-1])
    steps[0] += cycles
    np.add.accumulate(steps, out=out[head:])
    return step


def _in_rows(
    turns: FloatArray, cycles: int, step: int, out: npt.NDArray[np.int64], scratch: Scratch
) -> tuple[int, int]:
    """Whole rows; cycle count and step after them."""
    rows = scratch.a[: len(turns)].reshape(-1, ROW)
    np.matmul(turns.reshape(-1, ROW), _TURN_COUNTS, out=rows)
    before = np.empty((len(rows) + 1, 2))  # step and cycle count before each row, and after the last one
    steps, counts = before[:, 0], before[:, 1]
    steps[0], counts[0] = step, cycles
    np.subtract(rows[:, -1], rows[:, -2], out=steps[1:])
    np.add.accumulate(steps, out=steps)
    np.add(rows[:, -1], ROW * steps[:-1], out=counts[1:])
    np.add.accumulate(counts, out=counts)
    rows += np.matmul(before[:-1], _BEFORE_COUNTS)
    out[:] = rows.reshape(-1)
    return int(counts[-1]), int(steps[-1])
