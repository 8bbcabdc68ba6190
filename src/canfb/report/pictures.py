"""The pictures of a report: what a drive engineer looks at to trust a table, or not to."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from canfb.calibration.figures import BINS, root_mean
from canfb.report.plot import Plot
from canfb.report.scale import nice_limit
from canfb.signal.correction import CorrectionTable
from canfb.signal.phase import FloatArray, wrap

HIGHEST_ORDER = 20
PERCENT = 100.0
HISTOGRAM_BINS = 48
SIGMAS = 5.0


def error_over_phase(before: FloatArray, after: FloatArray, title: str) -> str:
    """Mean error in bins of the phase, both on one scale."""
    phase = (np.arange(BINS) + 0.5) / BINS
    most = PERCENT * nice_limit(np.concatenate([before, after]))
    plot = Plot(title, (0.0, 1.0), (-most, most), ("phase, cycles", "error, % of a cycle"))
    plot.line(phase, PERCENT * before, "before", "before")
    plot.line(phase, PERCENT * after, "after", "after")
    return plot.svg()


def remaining_error(after: FloatArray, uncertainty: float) -> str:
    """What is left, on a scale of its own, with the uncertainty of the table."""
    phase = (np.arange(BINS) + 0.5) / BINS
    most = PERCENT * nice_limit(after, 1.3 * uncertainty)
    plot = Plot(
        "Remaining mean error over the phase",
        (0.0, 1.0),
        (-most, most),
        ("phase, cycles", "error, % of a cycle"),
    )
    plot.line(phase, PERCENT * after, "after", "after, mean of each 1/64 cycle")
    plot.level(PERCENT * uncertainty, "limit dashed", "uncertainty of the table")
    plot.level(-PERCENT * uncertainty, "limit dashed")
    return plot.svg()


def rms_over_speed(speed: FloatArray, before: FloatArray, after: FloatArray, unit: str) -> str:
    """Rms error at each speed, cycles, shape (n,); NaN where the position was lost."""
    values = np.concatenate([before, after])
    values = values[np.isfinite(values) & (values > 0.0)] if np.any(values > 0.0) else np.array([1e-4])
    low = 10.0 ** np.floor(np.log10(PERCENT * float(values.min())))
    high = 10.0 ** np.ceil(np.log10(1.01 * PERCENT * float(values.max())))
    labels = (f"speed, {unit}", "error rms, % of a cycle")
    plot = Plot("Rms error over the speed, before and after", _span(speed), (low, high), labels, log_y=True)
    _draw_both(plot, speed, before, after)
    return plot.svg()


def mean_over_speed(speed: FloatArray, before: FloatArray, after: FloatArray, unit: str) -> str:
    """Mean error at each speed, cycles, shape (n,); NaN where it is not known."""
    most = PERCENT * nice_limit(np.concatenate([before, after]), 1e-5)
    labels = (f"speed, {unit}", "mean error, % of a cycle")
    plot = Plot("Mean error over the speed, before and after", _span(speed), (-most, most), labels)
    _draw_both(plot, speed, before, after)
    return plot.svg()


def _span(speed: FloatArray) -> tuple[float, float]:
    return min(0.0, 1.05 * float(speed.min())), max(0.0, 1.05 * float(speed.max()))


def _draw_both(plot: Plot, speed: FloatArray, before: FloatArray, after: FloatArray) -> None:
    for values, style in ((before, "before"), (after, "after")):
        known = np.isfinite(values)
        plot.line(speed[known], PERCENT * values[known], style, style)
        plot.dots(speed[known], PERCENT * values[known], style)


def harmonics(before: FloatArray, after: FloatArray, noise_rms: float, samples: int) -> str:
    """Amplitudes of the harmonics of the error over the phase, before and after."""
    orders = np.arange(1, HIGHEST_ORDER + 1)
    place = orders.astype(np.float64)
    old, new = (PERCENT * _amplitudes(curve)[orders] for curve in (before, after))
    floor = PERCENT * 2.0 * noise_rms / np.sqrt(max(1, samples))
    low = 10.0 ** np.floor(np.log10(max(float(np.min(new)), 0.3 * floor, 1e-7)))
    high = 10.0 ** np.ceil(np.log10(max(float(old.max()), float(new.max()), 10.0 * low)))
    plot = Plot(
        "Harmonics of the error, before and after",
        (0.3, HIGHEST_ORDER + 0.7),
        (low, high),
        ("harmonic of the cycle", "amplitude, % of a cycle"),
        log_y=True,
    )
    plot.bars(place - 0.2, old, 0.36, "before", "before")
    plot.bars(place + 0.2, new, 0.36, "after", "after")
    plot.level(floor, "limit dashed", "level of noise alone")
    return plot.svg()


def histogram(error: FloatArray, rms: float, noise_cycles: float) -> str:
    """Deviation of single samples with the table, and what noise alone would give.

    ``error`` in cycles, shape (n,); ``rms`` is theirs, corrected for what the smooth motion took with it.
    """
    span = SIGMAS * max(rms, noise_cycles, 1e-9)
    # A cubic through each block takes some of the noise with it: the same factor as in the rms.
    error = error * (rms / max(root_mean(error), 1e-15))
    count, edges = np.histogram(error, HISTOGRAM_BINS, (-span, span))
    middle = np.asarray((edges[:-1] + edges[1:]) / 2.0, np.float64)
    width = float(edges[1] - edges[0])
    noise = np.asarray(len(error) * width * _gauss(middle, noise_cycles), np.float64)
    most = 1.1 * max(float(count.max()), float(noise.max()), 1.0)
    plot = Plot(
        "Histogram of the deviation of single samples, with the noise",
        (-PERCENT * span, PERCENT * span),
        (0.0, most),
        ("deviation of a sample, % of a cycle", "samples"),
    )
    plot.bars(PERCENT * middle, count.astype(np.float64), 0.92 * PERCENT * width, "after", "samples")
    plot.line(PERCENT * middle, noise, "limit", "noise of the measurement, alone")
    return plot.svg()


def coverage(samples: npt.NDArray[np.int64]) -> str:
    """Samples in each 1/64 of the cycle, shape (64,)."""
    count = samples.astype(np.float64)
    plot = Plot(
        "Samples over the phase",
        (0.0, 1.0),
        (0.0, 1.15 * max(float(count.max()), 1.0)),
        ("phase, cycles", "samples in 1/64 cycle"),
    )
    plot.bars((np.arange(BINS) + 0.5) / BINS, count, 0.9 / BINS, "after", "used")
    plot.level(float(count.sum()) / BINS, "limit dashed", "even coverage")
    return plot.svg()


def table_curve(table: CorrectionTable, before: CorrectionTable | None) -> str:
    """The correction itself: phase less raw phase, of the new table and of the one before."""
    place = np.arange(513) / 512.0
    curves = [("after", "new table", table)]
    if before is not None:
        curves.insert(0, ("before", "table before", before))
    lines = [(style, name, PERCENT * wrap(table(place[:-1]) - place[:-1])) for style, name, table in curves]
    most = nice_limit(np.concatenate([line for _, _, line in lines]))
    plot = Plot(
        "Correction over the raw phase",
        (0.0, 1.0),
        (-most, most),
        ("raw phase, cycles", "correction, % of a cycle"),
    )
    for style, name, line in lines:
        plot.line(place[:-1], line, style, name)
    return plot.svg()


def _amplitudes(curve: FloatArray) -> FloatArray:
    seen = np.isfinite(curve)
    if not seen.any():
        return np.zeros(BINS // 2 + 1)
    place = np.arange(BINS)
    filled = np.interp(place, place[seen], curve[seen], period=BINS)
    # A mean over a bin flattens the higher ones a little: undone.
    spectrum = np.abs(np.fft.rfft(filled)) / BINS * 2.0
    return np.asarray(spectrum / np.sinc(np.arange(len(spectrum)) / BINS), np.float64)


def _gauss(values: FloatArray, sigma: float) -> FloatArray:
    width = max(sigma, 1e-12)
    return np.asarray(np.exp(-0.5 * (values / width) ** 2) / (width * np.sqrt(2.0 * np.pi)), np.float64)
