"""Change of the tracks in time, found from their Lissajous figure, which does not depend on the motion.

The relative distance of the samples from the mean figure is fitted in each window by orders 0 to 2 of the
angle and a ramp. Order 0 and the ramp are the amplitude of both tracks, which does not affect the phase.
Offsets give order 1, gains and the phase error order 2; they shift the phase by the same amount, in radians.
"""

from __future__ import annotations

import numpy as np

from canfb.calibration.joint import Waveform, grid_phases, inverse
from canfb.calibration.recording import Recording
from canfb.calibration.result import SIGNIFICANT, TRACK_POINTS, Drift
from canfb.signal.conditioning import Conditioning
from canfb.signal.phase import BoolArray, FloatArray, raw_phases, wrap

WINDOWS = 9, 27, 81, 243  # windows per measurement: few show slow changes, many those near either end
FEWEST = 40  # samples of a window, six times the number of coefficients
EVEN = 0.1  # smallest eigenvalue of the normal matrix per sample; uniformly distributed phases give 1/3
OUTLIER = 10.0  # times the median deviation: a faulty sample
LAGS, STOOD_CYCLES = 8, 0.02  # at standstill the phase moves no further than STOOD_CYCLES in LAGS samples


def change_of_figure(record: Recording, waveform: Waveform, conditioning: Conditioning) -> Drift:
    """The largest deviation from the mean tracks in any window.

    Deviations below the scatter of single samples are ignored: an amplitude that varies over the revolution
    causes them.
    """
    tracks = conditioning.apply(*waveform.tracks(grid_phases(TRACK_POINTS)[:-1]))
    counts = conditioning.apply(record.sine[record.valid], record.cosine[record.valid])
    sizes = np.interp(raw_phases(*counts), raw_phases(*tracks), np.hypot(*tracks), period=1.0)
    off, angle = (np.hypot(*counts) / sizes - 1.0) / (2.0 * np.pi), np.arctan2(*counts)
    tells = _moves(angle / (2.0 * np.pi)) & (sizes > 0.0)  # standstill samples one phase only
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
    """The phase error in a window, cycles; zero unless significant and its rms above ``scatter``."""
    columns = np.vstack([orders, np.ones(len(off)), np.linspace(-1.0, 1.0, len(off))]).T
    if np.linalg.eigvalsh(columns.T @ columns / len(off))[0] < EVEN:
        return Drift()
    rest, kept = np.abs(off - np.median(off)), np.zeros(len(off), np.bool_)
    for _ in range(3):
        before, kept = kept, rest <= OUTLIER * np.median(rest)
        if np.array_equal(before, kept):
            break  # converged: the next fit would be the same
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
