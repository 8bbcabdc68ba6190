"""Positions of a whole recording, also of one that starts at speed or with uneven sample times.

Phases alone leave the speed open by a whole number s of cycles per sample. With even sample times
that does not matter: the position is then off by a straight line, s k, as smooth as the motion. With
uneven ones the wrong speed expects s (t - k) too much, t the time in sampling intervals: nothing while the
times are even, any phase at the first interval that is not. So all speeds that join the first two samples
are followed over the whole recording, and the one with the least sum of squares of its residuals is taken.
Where two fit equally well, both give the same positions but for a straight line.

Residuals are those of eq. 9 over the elapsed times, with one difference: the speed is taken over
BASELINE at least. Two samples 0.1 interval apart would multiply their phase errors by ten.
"""

from __future__ import annotations

import itertools

import numpy as np

from canfb.calibration.motion_blocks import IntArray
from canfb.signal.phase import FloatArray
from canfb.signal.tracking import track

# Cycles per interval: far beyond 3000 rpm of 5000 cycles at 1 kHz.
FASTEST = 512.0
# Intervals; nearly one, so that times with some jitter are followed as by eq. 9.
BASELINE = 0.75
LONGEST_LAG = 64  # samples; so many within BASELINE are a flood, not a sampling
# Speeds are given up, and those that have become one are joined, every so many samples.
PRUNE_SAMPLES = 32
# A speed whose sum of squares is worse by so many mean squares is wrong (10 standard deviations) ...
WRONG = 100.0
# ... and one that is worse by no more than so many fits as well as the best (3 standard deviations).
ALIKE = 9.0
# Mean squares of residuals, cycle^2, at least: 16 bits leave more; and what a poor encoder that is not
# corrected yet may show at the first phase that it has not met before.
LEAST_SQUARE, POOR_SQUARE = 1e-8, 2e-4
LONG = 1.5  # intervals: over more than these the speed after them counts as well


def positions(phase: FloatArray, time: FloatArray, uneven: bool, breaks: IntArray) -> FloatArray:
    """Positions in cycles; each segment starts near 0, and even ones may be off by a straight line.

    ``phase`` in cycles, NaN where there is none (the position is interpolated there, with uneven
    times); ``time`` in sampling intervals, rising; ``breaks`` the first samples of all segments but
    the first.
    """
    position = np.empty(len(phase))
    speed = 0.0
    for start, stop in itertools.pairwise([0, *(int(b) for b in breaks), len(phase)]):
        part = slice(start, stop)
        if uneven:
            position[part], speed = _follow_uneven(phase[part], time[part], speed)
        else:
            result = track(phase[part], 0.5)
            position[part] = result.cycles + result.phase
    return position


def _follow_uneven(phase: FloatArray, time: FloatArray, likely: float) -> tuple[FloatArray, float]:
    """Positions and the speed at the end, cycles per interval.

    ``likely``: the speed to take among those that fit equally well is the one nearest to it.
    """
    seen = np.flatnonzero(~np.isnan(phase))
    if len(seen) < 2 or time[seen[-1]] - time[seen[0]] < BASELINE:
        return np.zeros(len(phase)) + (phase[seen[0]] if len(seen) else 0.0), likely
    p, t = phase[seen], time[seen]
    first, k = int(np.searchsorted(t, t[0] + BASELINE)), np.arange(len(t))
    base = np.searchsorted(t, t[k - 1] - BASELINE, side="right") - 1
    base = np.where(k > first, np.maximum(base, k - 1 - LONGEST_LAG), 0)
    elapsed = float(t[first] - t[0])
    most = np.ceil(FASTEST * elapsed)
    turns, square, rows = _run(p, t, first, base, np.arange(-most, most + 1.0))
    alike = turns[square <= square.min() + ALIKE * _mean_square(square, len(rows), LEAST_SQUARE)]
    turn = alike[np.argmin(np.abs((alike + p[first] - p[0]) / elapsed - likely))]
    position = np.concatenate(_run(p, t, first, base, np.array([turn]))[2])
    position = _over_gaps(position, t, first, base)
    at = base[-1] + 1
    return np.interp(time, t, position), float((position[-1] - position[at]) / (t[-1] - t[at]))


def _run(
    phase: FloatArray, time: FloatArray, first: int, base: IntArray, turns: FloatArray
) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
    """Follow the motions that have passed these whole cycles from sample 0 to ``first``, straight until there.

    The speed before sample k is that from sample ``base[k]`` to k - 1. Until one is left: those still open, the
    sums of the squares of their residuals, relative to those of phase errors of rms 1, and their positions.
    """
    part = ((time[: first + 1] - time[0]) / (time[first] - time[0]))[:, None]
    line = phase[0] + part * (turns + (phase[first] - phase[0]))
    start = phase[: first + 1, None]
    rows = list(np.rint(line - start) + start)
    square = np.sum((line - rows) ** 2 / (1.0 + (1.0 - part) ** 2 + part**2), axis=0)
    open_for_long = len(turns) > 1
    weights = np.append(0.0, np.diff(time)) / np.maximum(time[np.arange(len(time)) - 1] - time[base], 1e-30)
    scales = 1.0 / (1.0 + (1.0 + weights) ** 2 + weights**2)
    for k in range(first + 1, len(phase)):
        ahead = rows[-1] + (rows[-1] - rows[base[k]]) * weights[k]
        rows.append(np.rint(ahead - phase[k]) + phase[k])
        square += (ahead - rows[-1]) ** 2 * scales[k]
        if open_for_long and k % PRUNE_SAMPLES == 0:
            keep = _still_open(np.array(rows[-LONGEST_LAG - 1 :]), square, k)
            turns, square = turns[keep], square[keep]
            rows[-LONGEST_LAG - 2 :] = [row[keep] for row in rows[-LONGEST_LAG - 2 :]]
            if len(turns) == 1:
                break
    return turns, square, rows


def _mean_square(square: FloatArray, taken: int, least: float) -> float:
    return max(float(square.min()) / taken, least)


def _still_open(latest: FloatArray, square: FloatArray, taken: int) -> IntArray:
    """Motions to go on with: not wrong, and of those with the same latest steps only the best."""
    order = np.argsort(square, kind="stable")
    order = order[square[order] <= square.min() + WRONG * _mean_square(square, taken, POOR_SQUARE)]
    steps = latest[:, order] - latest[-1, order]
    _, first = np.unique(np.rint(steps - steps[:, :1]), axis=1, return_index=True)
    return np.sort(order[first])


def _over_gaps(position: FloatArray, time: FloatArray, first: int, base: IntArray) -> FloatArray:
    """The positions with those of long intervals from the speeds on both sides, as for constant acceleration.

    The speed before alone errs by A T (T + 1) / 2: half a cycle after nine intervals of 0.011 cycle each^2.
    """
    end = np.flatnonzero(np.diff(time) > LONG) + 1
    after = np.searchsorted(time, time[end] + BASELINE)
    known = (end > first) & (after < len(time))
    end, after = end[known], after[known]
    begin = end - 1
    before = base[end]
    ahead, gap, behind = time[begin] - time[before], time[end] - time[begin], time[after] - time[end]
    early = (position[begin] - position[before]) / ahead
    late = (position[after] - position[end]) / behind
    middle = early + (late - early) * (ahead + gap) / (ahead + 2.0 * gap + behind)
    shift = np.zeros(len(time))
    shift[end] = np.rint(middle * gap - (position[end] - position[begin]))
    # Two long intervals in a row: the speed over the second is none to judge the first by.
    shift[end[after > np.append(end[1:], len(time))]] = 0.0
    return np.asarray(position + np.cumsum(shift), np.float64)
