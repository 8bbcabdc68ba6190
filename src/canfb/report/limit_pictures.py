"""Pictures of the limits of the supervision, and of what a machine shows within them."""

from __future__ import annotations

import numpy as np

from canfb.calibration.figures import BINS
from canfb.report.plot import Plot
from canfb.report.scale import nice_limit
from canfb.signal.phase import FloatArray

HISTOGRAM_BINS = 150
MOST_POINTS = 600  # of a curve over time: each is the lowest and the highest value of a stretch


def residual_histogram(residual: FloatArray, before: float, new: float) -> str:
    """Size of the residuals, cycles, NaN where there is none, with the limit before and the new one."""
    sizes = np.abs(residual[np.isfinite(residual)])
    most = 1.08 * max(before, new, float(sizes.max(initial=0.0)))
    count, edges = np.histogram(sizes, HISTOGRAM_BINS, (0.0, most))
    top = 10.0 ** np.ceil(np.log10(max(float(count.max()), 10.0)))
    plot = Plot(
        "Histogram of the residual of single samples, with the limits",
        (0.0, most),
        (0.5, float(top)),
        ("residual, cycles", "samples"),
        log_y=True,
    )
    width = float(edges[1] - edges[0])
    middle = np.asarray((edges[:-1] + edges[1:]) / 2.0, np.float64)
    plot.bars(middle, np.where(count, count, np.nan), 0.92 * width, "after", "samples")
    ends = np.array([0.5, float(top)])
    plot.line(np.array([before, before]), ends, "before dashed", "residual limit before")
    plot.line(np.array([new, new]), ends, "limit dashed", "residual limit proposed")
    return plot.svg()


def amplitude_over_phase(over_phase: FloatArray, low: float, high: float) -> str:
    """Lowest, mean and highest amplitude in each 1/64 cycle, counts, shape (3, 64), with its limits."""
    place = (np.arange(BINS) + 0.5) / BINS
    seen = over_phase[np.isfinite(over_phase)]
    top = 1.08 * max(high, float(seen.max(initial=0.0)))
    bottom = 0.92 * min(low, float(seen.min(initial=low)))
    plot = Plot(
        "Amplitude over the phase, with its limits",
        (0.0, 1.0),
        (bottom, top),
        ("phase, cycles", "amplitude, counts"),
    )
    lowest, mean, highest = over_phase
    plot.line(place, lowest, "after thin", "lowest and highest")
    plot.line(place, highest, "after thin")
    plot.line(place, mean, "after", "mean")
    plot.level(low, "limit dashed", "amplitude limits proposed")
    plot.level(high, "limit dashed")
    return plot.svg()


def acceleration_over_time(acceleration: FloatArray, interval_s: float, largest: float) -> str:
    """Acceleration at each sample, rad/s², NaN where not known, with the limit; 0: there is none."""
    time, low, high = _stretches(acceleration, interval_s)
    most = nice_limit(np.concatenate([low, high]), 1.1 * largest)
    plot = Plot(
        "Acceleration over time, with its limit",
        (0.0, max(len(acceleration) * interval_s, interval_s)),
        (-most, most),
        ("time, s", "acceleration, rad/s²"),
    )
    xs = np.repeat(time, 2)
    plot.line(xs, np.column_stack([low, high]).reshape(-1), "after thin", "machine")
    if largest:
        plot.level(largest, "limit dashed", "largest acceleration proposed")
        plot.level(-largest, "limit dashed")
    return plot.svg()


def _stretches(values: FloatArray, interval_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Time of each stretch, and its lowest and highest value; NaN where it has none."""
    parts = np.array_split(values, min(MOST_POINTS, max(1, len(values))))
    known = [part[np.isfinite(part)] for part in parts]
    low = np.array([part.min() if len(part) else np.nan for part in known])
    high = np.array([part.max() if len(part) else np.nan for part in known])
    time = (np.arange(len(parts)) + 0.5) * len(values) / len(parts) * interval_s
    return np.asarray(time, np.float64), low, high
