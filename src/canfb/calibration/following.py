"""Positions of a whole recording, also of one that starts at speed or with uneven sample times.

Phases alone leave the speed open by a whole cycle per sample. With even sample times that
does not matter here: the position is then off by a straight line, which is as smooth as
the motion. With uneven ones a wrong line shows, because it rises per sample and not per
time: so the speed at the start is searched for, and put right by what shows in the end.
"""

from __future__ import annotations

import itertools

import numpy as np

from canfb.calibration.motion_blocks import IntArray, cut
from canfb.signal.phase import FloatArray
from canfb.signal.tracker import Tracker
from canfb.signal.tracking import track

# Cycles per sample: far beyond 3000 rpm of 5000 cycles at 1 kHz.
FASTEST = 512.0
SEARCH_STEP = 1.0 / 32.0
SEARCH_SAMPLES = 24
# Spread of the phase steps at the right speed, as 1 - mean resultant: harmonics, acceleration.
COHERENT = 0.05
LINE_BLOCK = 16
LINE_CERTAIN = 3.0
CORRECTIONS = 4


def positions(phase: FloatArray, time: FloatArray, uneven: bool, breaks: IntArray) -> FloatArray:
    """Positions in cycles; each segment starts near 0, and even ones may be off by a straight line.

    ``phase`` in cycles, NaN where there is none; ``time`` in sampling intervals.
    """
    position = np.empty(len(phase))
    for start, stop in itertools.pairwise([0, *(int(b) for b in breaks), len(phase)]):
        part = slice(start, stop)
        if uneven:
            position[part] = _follow_uneven(phase[part], time[part])
        else:
            result = track(phase[part], 0.5)
            position[part] = result.cycles + result.phase
    return position


def _follow_uneven(phase: FloatArray, time: FloatArray) -> FloatArray:
    speed = _starting_speed(phase, time)
    position = _follow(phase, time, speed)
    for _ in range(CORRECTIONS):
        wrong = _wrong_line(position, phase, time)
        if not wrong:
            break
        speed += wrong
        position = _follow(phase, time, speed)
    return position


def _follow(phase: FloatArray, time: FloatArray, speed: float) -> FloatArray:
    """Eq. 9 over the elapsed times, seen from something that moves with ``speed`` (cycles per interval)."""
    line = speed * (time - time[0])
    tracker = Tracker(0.5)
    elapsed = np.diff(time, prepend=time[0] - 1.0).tolist()
    followed = []
    for one, interval in zip(((phase - line) % 1.0 % 1.0).tolist(), elapsed, strict=True):
        result = tracker.update(one, interval)
        followed.append(result.cycles + result.phase)
    return np.asarray(np.array(followed) + line, np.float64)


def _starting_speed(phase: FloatArray, time: FloatArray) -> float:
    """Speed at the start in cycles per interval, the lowest that the first steps agree with; else 0."""
    seen = np.flatnonzero(~np.isnan(phase))[: SEARCH_SAMPLES + 1]
    if len(seen) < SEARCH_SAMPLES // 2:
        return 0.0
    step, elapsed = np.diff(phase[seen]), np.diff(time[seen])
    speeds = np.arange(-FASTEST, FASTEST + SEARCH_STEP, SEARCH_STEP)
    turns = np.exp(2j * np.pi * (step - speeds[:, None] * elapsed))
    spread = 1.0 - np.abs(turns.mean(axis=1))
    least = float(spread.min())
    if least > COHERENT:
        return 0.0
    alike = np.flatnonzero(spread <= 2.0 * least + 1e-4)
    return float(speeds[alike[np.argmin(np.abs(speeds[alike]))]])


def _wrong_line(position: FloatArray, phase: FloatArray, time: FloatArray) -> int:
    """Cycles per sample that the followed speed is off, from the unevenness of the times; 0 if unsure."""
    count = np.cumsum(np.rint(np.diff(time, prepend=time[0])))
    blocks = cut(time, ~np.isnan(phase), np.zeros(0, np.int64), LINE_BLOCK)
    if not len(blocks):
        return 0
    use = blocks.used
    off, lever = (
        values - blocks.evaluate(blocks.smooth(values))
        for values in (position[blocks.index], (time - count)[blocks.index])
    )
    # Blocks in which the count went wrong would outweigh all others.
    size = np.sqrt(np.mean(np.where(use, off, 0.0) ** 2, axis=1))
    good = use & (size <= 4.0 * np.median(size))[:, None]
    strength = float(np.sum(lever[good] ** 2))
    if strength <= 0.0:
        return 0
    slope = float(np.sum(off[good] * lever[good])) / strength
    uncertain = float(np.sqrt(np.mean((off[good] - slope * lever[good]) ** 2) / strength))
    return round(slope) if abs(slope) > LINE_CERTAIN * uncertain else 0
