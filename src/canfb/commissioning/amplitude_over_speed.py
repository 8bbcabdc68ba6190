"""Amplitude over the speed of a machine in its duty: the corner of a low-pass before the converter.

The limits of the amplitude (2001:03, 2001:04) hold at standstill where the module knows the corner (2001:05).
What is fitted is the amplitude without what is corrected already, in classes of the speed.
"""

from __future__ import annotations

import numpy as np

from canfb.calibration.path_fit import AMPLITUDE_REPEATS, LowPass, fit_low_pass
from canfb.commissioning.supervised_samples import SupervisedSamples
from canfb.signal.harmonics import Corners
from canfb.signal.phase import FloatArray

CLASSES = 12
LEAST_OF_CLASS = 100
LEAST_CLASSES = 3
LOWEST_PART = 0.5  # of the top speed: there must be one that is lower


def low_pass_seen(followed: SupervisedSamples, interval_s: float, corners: Corners) -> LowPass | None:
    """What these samples show, the known ``corners`` undone; None where there are too few speeds."""
    hertz = np.abs(followed.speed) / interval_s
    amplitude = followed.amplitude[1:]
    known = np.isfinite(hertz) & np.isfinite(amplitude)
    hertz, amplitude = hertz[known], amplitude[known] * _left(hertz[known], corners)
    if not len(hertz) or not hertz.max() > 0.0:
        return None
    number = np.minimum((hertz / hertz.max() * CLASSES).astype(np.int64), CLASSES - 1)
    classes = [number == one for one in range(CLASSES) if np.sum(number == one) >= LEAST_OF_CLASS]
    if len(classes) < LEAST_CLASSES:
        return None
    speeds = np.array([np.sqrt(np.mean(hertz[one] ** 2)) for one in classes])
    if speeds.min() > LOWEST_PART * speeds.max():
        return None
    sizes = np.array([amplitude[one].mean() for one in classes])
    spread = np.array([amplitude[one].std() / np.sqrt(np.sum(one)) for one in classes])
    return fit_low_pass(speeds, sizes, np.hypot(AMPLITUDE_REPEATS, spread / sizes))


def _left(hertz: FloatArray, corners: Corners) -> FloatArray:
    """Of the amplitude that the known low-passes leave: the mean of both tracks."""
    both = [hz for hz in (corners.corner_hz, corners.of_cosine_hz) if hz]
    left = [1.0 / np.hypot(1.0, hertz / hz) for hz in both]
    return np.asarray(np.mean(left, axis=0) if left else np.ones(len(hertz)), np.float64)
