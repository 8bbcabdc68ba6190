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
# What the turns of a row add to the step, and to the count beside the step before the row.
_TOTALS = np.stack([np.ones(ROW), _TURN_COUNTS[:, -1]], axis=1)
EXACT = 1 << 48  # sums of a row with counts of this size are exact in float64
# OpenBLAS starts threads for a product of more than 2^18 multiplications; they cost more than they save.
MOST_SAMPLES = (1 << 18) // ROW


def cycle_counts(
    turns: FloatArray, cycles: int, step: int, out: npt.NDArray[np.int64], scratch: Scratch
) -> int:
    """Add up step(k) = step(k-1) + turns(k), i(k) = i(k-1) + step(k), i into ``out``; the last step.

    ``cycles`` and ``step`` are i and step before the first of ``turns``, which are whole and at
    most 2 in size. Exact; ``turns``, ``scratch.a`` and ``scratch.index`` are overwritten.
    """
    products = -(-len(turns) // MOST_SAMPLES)
    head = len(turns) // (ROW * products) * (ROW * products)
    if abs(cycles) + abs(step) * head >= EXACT:
        head = 0
    if head:
        cycles, step = _in_rows(turns[:head].reshape(products, -1, ROW), cycles, step, out[:head], scratch)
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
    """Turns of shape (products, rows, ROW); cycle count and step after them."""
    rows = turns.reshape(-1, ROW)
    totals = np.matmul(turns, _TOTALS).reshape(-1, 2)
    steps, counts = np.empty(len(rows) + 1), np.empty(len(rows) + 1)  # before each row, and after the last
    steps[0], counts[0] = step, cycles
    steps[1:] = totals[:, 0]
    np.add.accumulate(steps, out=steps)
    np.multiply(steps[:-1], ROW, out=counts[1:])
    counts[1:] += totals[:, 1]
    np.add.accumulate(counts, out=counts)
    # Step y and count x before a row come in as turns, x + y at its first place and -x at the second one:
    # that makes the step x + y, and then y; one product gives the counts.
    rows[:, 1] -= counts[:-1]
    rows[:, 0] += counts[:-1] + steps[:-1]
    sums = np.matmul(turns, _TURN_COUNTS, out=scratch.a[: turns.size].reshape(turns.shape))
    out[:] = sums.reshape(-1)
    return int(counts[-1]), int(steps[-1])
