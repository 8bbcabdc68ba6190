"""Curves over the time of a log."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from canfb.report.plot import Plot
from canfb.signal.phase import FloatArray

FULL = 1.06


class Curve(NamedTuple):
    """Values at the times, NaN where there is none; the CSS class, and the words of the legend."""

    values: FloatArray
    style: str
    name: str | None


def over_time(
    title: str, label: str, time_s: FloatArray, curves: Sequence[Curve], least: float | None = None
) -> str:
    """An SVG of ``curves`` over ``time_s`` (seconds), ``label`` at its axis, from ``least`` on if given."""
    values = np.concatenate([curve.values for curve in curves])
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    room = (FULL - 1.0) * (high - low) or abs(high) or 1.0
    low = low - room if least is None else least
    last = float(time_s[-1]) if len(time_s) else 1.0
    plot = Plot(
        title, (0.0, last or 1.0), (low, high + room), ("time from the beginning of the log, s", label)
    )
    for curve in curves:
        if len(time_s) == 1:
            plot.dots(time_s, curve.values, curve.style, curve.name)
        else:
            plot.line(time_s, curve.values, curve.style, curve.name)
    return plot.svg()
