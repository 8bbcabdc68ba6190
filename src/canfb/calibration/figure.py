"""Tracks that change in time, by the figure that they draw: no motion alters it, and none has to be known.

How far samples are off it, relative to their amplitude, is fitted in a window by orders 0 to 2 of the angle
and a ramp. Order 0 and the ramp are the amplitude of both tracks, on which no phase depends. Offsets make
order 1, gains and the phase error order 2, and move the phase as far.
"""

from __future__ import annotations

import numpy as np

from canfb.calibration.joint import Waveform, grid_phases, inverse
from canfb.calibration.recording import Recording
from canfb.calibration.result import SIGNIFICANT, TRACK_POINTS, Drift
from canfb.signal.conditioning import Conditioning
from canfb.signal.phase import BoolArray, FloatArray, raw_phases, wrap

WINDOWS = 9, 27, 81, 243  # in a measurement: all of it, and what happens near either end
FEWEST = 40  # samples of a window, six times what is fitted
EVEN = 0.1  # the least eigenvalue of the columns: 0.5 for phases all over the cycle
OUTLIER = 10.0  # medians: the deviation of a fault
LAGS, STOOD_CYCLES = 8, 0.02  # in so many samples a machine that stands moves no further


def change_of_figure(record: Recording, waveform: Waveform, conditioning: Conditioning) -> Drift:
    """The largest deviation from the mean tracks in a window.

    Below the scatter of single samples it is none: so an amplitude looks that varies over the revolution.
    """
    tracks = conditioning.apply(*waveform.tracks(grid_phases(TRACK_POINTS)[:-1]))
    counts = conditioning.apply(record.sine[record.valid], record.cosine[record.valid])
    sizes = np.interp(raw_phases(*counts), raw_phases(*tracks), np.hypot(*tracks), period=1.0)
    off, angle = (np.hypot(*counts) / sizes - 1.0) / (2.0 * np.pi), np.arctan2(*counts)
    tells = _moves(angle / (2.0 * np.pi)) & (sizes > 0.0)  # at standstill there is one phase
    off, angle = off[tells], angle[tells]
    columns = np.array([part(order * angle) for order in (1, 2) for part in (np.cos, np.sin)])
    counted = [number for number in WINDOWS if len(off) >= FEWEST * number]
    windows = [part for number in counted for part in np.array_split(np.arange(len(off)), number)]
    scatter = float(np.median(np.abs(off))) if windows else 0.0
    return max((_deviation(columns[:, part], off[part], scatter) for part in windows), default=Drift())


def _moves(phase: FloatArray) -> BoolArray:
    moves = np.zeros(len(phase), np.bool_)
    for lag in range(1, 1 + LAGS):
        moves[lag:] |= np.abs(wrap(phase[lag:] - phase[:-lag])) > STOOD_CYCLES
    return moves


def _deviation(orders: FloatArray, off: FloatArray, scatter: float) -> Drift:
    """The significant error of the phase in a window, its rms beyond ``scatter``; cycles."""
    columns = np.vstack([orders, np.ones(len(off)), np.linspace(-1.0, 1.0, len(off))]).T
    if np.linalg.eigvalsh(columns.T @ columns / len(off))[0] < EVEN:
        return Drift()
    rest, kept = np.abs(off - np.median(off)), np.zeros(len(off), np.bool_)
    for _ in range(3):
        before, kept = kept, rest <= OUTLIER * np.median(rest)
        if np.array_equal(before, kept):
            break  # the fit would be the same
        found = np.linalg.lstsq(columns[kept], off[kept], rcond=None)[0]
        rest = np.abs(off - columns @ found)
    square = float(np.sum(found[:4] ** 2)) / 2.0
    if square <= scatter**2:
        return Drift()
    noise = np.sum(rest[kept] ** 2) / (kept.sum() - len(found))
    variance = float(noise * inverse(columns[kept].T @ columns[kept]).diagonal()[:4].sum()) / 2.0
    if square <= SIGNIFICANT**2 * variance:
        return Drift()
    return Drift(float(np.sqrt(square - variance)), float(np.hypot(*found[:2]) + np.hypot(*found[2:4])))
