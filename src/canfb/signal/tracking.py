"""Eq. 9 and eq. 12 over arrays: bit for bit as one sample after the other.

The cycle count is the double cumulative sum of the turns between the samples, in integers. A matrix product
adds up rows of 16 samples side by side, which is faster than numpy's running sums.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from canfb.signal.blocks import Scratch, blocks
from canfb.signal.phase import FloatArray, real_array
from canfb.signal.tracker import RESIDUAL_LIMIT, Tracker, TrackResult

PLACES_BEFORE = 2  # a run starts from the samples that eq. 9 predicts by
ROW = 16
_PLACES = np.arange(1.0, ROW + 1.0)
# A turn at one place of a row is in the step, and so in each later count once more: at a later
# place it counts as often as the places are apart, and once.
_TURN_COUNTS = np.maximum(0.0, _PLACES - _PLACES[:, np.newaxis] + 1.0)
# What the turns of a row add to the step, and to the count beside the step before the row.
_TOTALS = np.stack([np.ones(ROW), _TURN_COUNTS[:, -1]], axis=1)
EXACT = 1 << 48  # sums of a row with counts of this size are exact in float64
# OpenBLAS starts threads for a product of more than 2^18 multiplications; they cost more than they save.
MOST_IN_PRODUCT = (1 << 18) // ROW


def track(
    phase: npt.ArrayLike, residual_limit: float = RESIDUAL_LIMIT, speed_cycles: float = 0.0
) -> TrackResult:
    """:class:`Tracker` over an array of phases, vectorised; bit for bit the same result.

    ``phase`` has shape (n,), cycles, 0 <= phase < 1, NaN where a sample has no phase. ``speed_cycles`` is
    the speed at the first phase, cycles per sample. ``ok`` says no more than eq. 12; :func:`canfb.process`
    says where the position is certain. ValueError for anything else.
    """
    phases = real_array("phase", phase)
    if phases.ndim != 1:
        raise ValueError(f"phase must have one dimension, not {phases.ndim}")
    wrong = np.flatnonzero((phases < 0.0) | (phases >= 1.0))
    if len(wrong):
        raise ValueError(f"phase must be 0 <= phase < 1 cycle, not {phases[wrong[0]]!r} at {wrong[0]}")
    result = TrackResult.empty(len(phases))
    result.phase[:] = phases
    tracker = Tracker(residual_limit, speed_cycles)
    for part, scratch in blocks(len(phases)):
        track_block(tracker, result, part, scratch)
    return result


def track_block(tracker: Tracker, result: TrackResult, part: slice, scratch: Scratch) -> None:
    """Continue ``tracker`` over ``result.phase[part]`` (unchecked), as :meth:`Tracker.update` would.

    Fills ``result[part]``. Blocks follow each other from the first sample on.
    """
    start = part.start
    np.isnan(result.phase[part], out=scratch.bit)
    for gap in (np.flatnonzero(scratch.bit) + start).tolist():
        if gap >= start:
            steady_run(tracker, result, start, gap, scratch)
            start = _step_over(tracker, result, gap, part.stop)
    steady_run(tracker, result, start, part.stop, scratch)


def _step_over(tracker: Tracker, result: TrackResult, at: int, stop: int) -> int:
    usable = 0
    while at < stop and usable < PLACES_BEFORE:
        usable = 0 if math.isnan(result.phase[at]) else usable + 1
        _take_one(tracker, result, at)
        at += 1
    return at


def _take_one(tracker: Tracker, result: TrackResult, at: int) -> None:
    one = tracker.update(float(result.phase[at]))
    result.cycles[at], result.phase[at], result.residual[at], result.ok[at] = one


def continues(tracker: Tracker, result: TrackResult, at: int) -> bool:
    if at < PLACES_BEFORE or not tracker.is_steady:
        return False
    before = (*result.phase[at - PLACES_BEFORE : at].tolist(), int(result.cycles[at - 1]))
    return tracker.state()[:3] == before


def write_places_before(tracker: Tracker, result: TrackResult, at: int) -> None:
    """What eq. 9 needs of a steady tracker, two places before ``at``; of another one, what nothing reads."""
    cycles, phase = result.cycles, result.phase
    phase[at - 2], phase[at - 1], last, step = tracker.state()
    cycles[at - 1], cycles[at - 2] = last, last - step


def steady_run(tracker: Tracker, result: TrackResult, start: int, stop: int, scratch: Scratch) -> None:
    """Samples start..stop, all with a phase and one interval apart: an integer cumulative sum.

    ``scratch`` is at least as long as the run.
    """
    while start < stop and not continues(tracker, result, start):
        _take_one(tracker, result, start)
        start += 1
    if start == stop:
        return
    _, _, cycles, step = tracker.state()
    phase, run = result.phase, slice(start, stop)
    residual = result.residual[run]
    c, turns = scratch.a[: stop - start], scratch.b[: stop - start]
    np.multiply(phase[start - 1 : stop - 1], 2.0, out=c)
    c -= phase[start - 2 : stop - 2]
    c -= phase[run]
    _round(c, turns, residual)
    np.less(residual, tracker.residual_limit, out=result.ok[run])
    last_step = cycle_counts(turns, cycles, step, result.cycles[run], scratch)
    tracker.set_state(float(phase[stop - 2]), float(phase[stop - 1]), int(result.cycles[stop - 1]), last_step)


def _round(c: FloatArray, turns: FloatArray, residual: FloatArray) -> None:
    np.rint(c, out=turns)
    np.subtract(turns, c, out=c)
    np.abs(c, out=residual)


def cycle_counts(
    turns: FloatArray, cycles: int, step: int, out: npt.NDArray[np.int64], scratch: Scratch
) -> int:
    """Add up step(k) = step(k-1) + turns(k), i(k) = i(k-1) + step(k), i into ``out``; the last step.

    ``turns`` are whole, at most 2 in size, and overwritten, as ``scratch.a`` and ``scratch.index``. Exact.
    """
    products = -(-len(turns) // MOST_IN_PRODUCT)
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
