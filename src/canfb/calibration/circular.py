"""Means of phases, which have no first and no last."""

from __future__ import annotations

import numpy as np

from canfb.signal.phase import FloatArray, wrap


def about_mean(
    off: FloatArray, of: FloatArray | None = None, weights: FloatArray | None = None
) -> FloatArray:
    """Differences of phases (cycles) within half a cycle about their mean, or that of other ones, ``of``.

    The mean is the angle of the mean of the unit vectors, weighted by ``weights`` if given.
    """
    vectors = np.exp(2j * np.pi * (off if of is None else of))
    middle = np.angle(np.average(vectors, weights=weights)) / (2.0 * np.pi)
    return wrap(off - middle)
