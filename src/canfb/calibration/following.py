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
from typing import NamedTuple

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
    steps = _Steps.of(phase[seen], time[seen])
    counts = _follow(steps, _decide(steps, likely))
    position = counts + phase[seen]
    speed = (position[-1] - position[-1 - steps.lag[-1]]) / (time[seen[-1]] - time[seen[-1 - steps.lag[-1]]])
    return np.interp(time, time[seen], position), float(speed)


class _Steps(NamedTuple):
    """What a step to each sample needs; arrays over the samples, valid behind ``first``.

    first    the first sample that is BASELINE or more after sample 0
    lag      the speed before sample k is taken from samples k - 1 - lag and k - 1
    weight   intervals from k - 1 to k over those of the baseline
    ahead    predicted phase less the phase of k, both samples of the baseline in cycle count 0; cycles
    scale    residuals are multiplied by it: 1 / (their rms for phase errors of rms 1)
    """

    phase: FloatArray
    time: FloatArray
    first: int
    lag: IntArray
    weight: FloatArray
    ahead: FloatArray
    scale: FloatArray

    @classmethod
    def of(cls, phase: FloatArray, time: FloatArray) -> _Steps:
        first = int(np.searchsorted(time, time[0] + BASELINE))
        at = np.arange(1, len(time))
        base = np.searchsorted(time, time[:-1] - BASELINE, side="right") - 1
        base = np.maximum(base, at - 1 - LONGEST_LAG)
        base = np.where(at > first, base, 0)
        over = np.where(at > first, time[:-1] - time[base], 1.0)
        weight = np.diff(time) / over
        ahead = phase[:-1] + weight * (phase[:-1] - phase[base]) - phase[1:]
        scale = 1.0 / np.sqrt(1.0 + (1.0 + weight) ** 2 + weight**2)
        lag = at - 1 - base
        return cls(
            phase,
            time,
            first,
            np.append(0, lag).astype(np.int64),
            np.append(0.0, weight),
            np.append(0.0, ahead),
            np.append(1.0, scale),
        )

    def begin(self, turns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Cycle counts of samples 0 .. first, (samples, speeds), and their sum of squares of residuals.

        ``turns``: cycle count of sample ``first``. The samples in between lie on the line to it.
        """
        phase = self.phase[: self.first + 1, None]
        part = ((self.time[: self.first + 1] - self.time[0]) / (self.time[self.first] - self.time[0]))[
            :, None
        ]
        off = phase[0] + part * (turns + (phase[-1] - phase[0])) - phase
        counts = np.rint(off)
        counts[0], counts[-1] = 0.0, turns
        square = (off - counts) ** 2 / (1.0 + (1.0 - part) ** 2 + part**2)
        return counts, np.asarray(square[1:-1].sum(axis=0), np.float64)


def _decide(steps: _Steps, likely: float) -> float:
    """Cycle count of sample ``first``, the one of sample 0 being 0."""
    elapsed = float(steps.time[steps.first] - steps.time[0])
    most = np.ceil(FASTEST * elapsed)
    turns = np.arange(-most, most + 1.0)
    first, square = steps.begin(turns)
    rows = max(steps.first, int(steps.lag.max())) + 2
    counts = np.zeros((rows, len(turns)))  # of the last samples, that of k in row k modulo ``rows``
    counts[: steps.first + 1] = first
    lag, weight, ahead, scale = (one.tolist() for one in steps[3:])
    taken = max(0, steps.first - 1)
    for k in range(steps.first + 1, len(weight)):
        last = counts[(k - 1) % rows]
        off = (last - counts[(k - 1 - lag[k]) % rows]) * weight[k]
        off += ahead[k]
        step = np.rint(off)
        counts[k % rows] = last + step
        off -= step
        off *= scale[k]
        square += off * off
        taken += 1
        if taken % PRUNE_SAMPLES == 0:
            keep = _still_open(counts, (k - np.arange(rows - 1)) % rows, square, taken)
            turns, square, counts = turns[keep], square[keep], counts[:, keep]
            if len(turns) == 1:
                break
    alike = turns[square <= square.min() + ALIKE * _mean_square(square, taken, LEAST_SQUARE)]
    speeds = (alike + (steps.phase[steps.first] - steps.phase[0])) / elapsed
    return float(alike[np.argmin(np.abs(speeds - likely))])


def _mean_square(square: FloatArray, taken: int, least: float) -> float:
    return max(float(square.min()) / max(1, taken), least)


def _still_open(counts: FloatArray, latest: IntArray, square: FloatArray, taken: int) -> IntArray:
    """Speeds to go on with: not wrong, and of those with the same last counts, only the best."""
    order = np.argsort(square, kind="stable")
    order = order[square[order] <= square.min() + WRONG * _mean_square(square, taken, POOR_SQUARE)]
    relative = counts[np.ix_(latest[: min(len(latest), taken)], order)] - counts[latest[0], order]
    _, first = np.unique(relative, axis=1, return_index=True)
    return np.sort(order[first])


def _follow(steps: _Steps, turns: float) -> FloatArray:
    """Cycle counts of all samples that go on from this count at sample ``first``."""
    first, _ = steps.begin(np.array([turns]))
    counts = first[:, 0].tolist()
    lag, weight, ahead = (one.tolist() for one in steps[3:6])
    for k in range(steps.first + 1, len(weight)):
        last = counts[-1]
        counts.append(last + round((last - counts[-1 - lag[k]]) * weight[k] + ahead[k]))
    return _over_gaps(steps, np.array(counts, np.float64))


def _over_gaps(steps: _Steps, counts: FloatArray) -> FloatArray:
    """The counts with those of long intervals from the speeds on both sides, as for constant acceleration.

    The speed before alone errs by A T (T + 1) / 2: half a cycle after nine intervals of 0.011 cycle each^2.
    """
    time, position = steps.time, counts + steps.phase
    end = np.flatnonzero(np.diff(time) > LONG) + 1
    after = np.searchsorted(time, time[end] + BASELINE)
    known = (end > steps.first) & (after < len(time))
    end, after = end[known], after[known]
    begin = end - 1
    before = begin - steps.lag[end]
    ahead, gap, behind = time[begin] - time[before], time[end] - time[begin], time[after] - time[end]
    first = (position[begin] - position[before]) / ahead
    last = (position[after] - position[end]) / behind
    middle = first + (last - first) * (ahead + gap) / (ahead + 2.0 * gap + behind)
    shift = np.zeros(len(time))
    shift[end] = np.rint(middle * gap - (position[end] - position[begin]))
    # Two long intervals in a row: the speed over the second is none to judge the first by.
    shift[end[after > np.append(end[1:], len(time))]] = 0.0
    return np.asarray(counts + np.cumsum(shift), np.float64)
