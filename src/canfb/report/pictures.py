"""The pictures of a report: what a drive engineer looks at to trust a table and limits, or not to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canfb.calibration.figures import BINS, root_mean
from canfb.report.plot import Plot, Scale, nice_limit, size_around
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import CorrectionTable
from canfb.signal.phase import FloatArray, wrap
from canfb.signal.supervision import SampleLimits

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
    known = np.isfinite(curve)
    if not known.any():
        return np.zeros(BINS // 2 + 1)
    place = np.arange(BINS)
    filled = np.interp(place, place[known], curve[known], period=BINS)
    # A mean over a bin flattens the higher ones a little: undone.
    spectrum = np.abs(np.fft.rfft(filled)) / BINS * 2.0
    return np.asarray(spectrum / np.sinc(np.arange(len(spectrum)) / BINS), np.float64)


def _gauss(values: FloatArray, sigma: float) -> FloatArray:
    width = max(sigma, 1e-12)
    return np.asarray(np.exp(-0.5 * (values / width) ** 2) / (width * np.sqrt(2.0 * np.pi)), np.float64)


SHOWN_SAMPLES = 4000
DENSITY_CELLS = (300, 150, 60)  # to the side of the picture; the first that makes no more dots than that
SHADES, FAINTEST = 5, 0.3
SIDE = 394.0  # of the square within the axes: a circle is drawn as one


def lissajous(
    sine: FloatArray, cosine: FloatArray, conditioning: Conditioning, limits: SampleLimits | None
) -> str:
    """Raw and conditioned samples, the circles of the amplitude limits, the ends of the converter.

    ``sine`` and ``cosine`` in ADC counts, shape (n,), NaN for a missed sample. Each sample is a dot; more
    than 4000 are shown by their density, so that none is left out.
    """
    known = np.isfinite(sine)
    sine, cosine = sine[known], cosine[known]
    s, c = conditioning.apply(sine, cosine)
    extent = [nice_limit(values) for values in (sine, cosine, s, c)]
    if limits is not None:
        extent += [1.02 * limits.full_scale_counts]
    plot = square_plot(
        "Lissajous figure: sine over cosine, raw and conditioned, with the limits of the amplitude",
        max(extent),
    )
    if limits is not None:
        box(plot, float(limits.full_scale_counts))
        circle(plot, limits.amplitude_low_counts, "limit dashed", "amplitude limits")
        circle(plot, limits.amplitude_high_counts, "limit dashed", None)
    if not conditioning.is_identity:
        cloud(plot, cosine, sine, "before", "raw")
    name = "raw" if conditioning.is_identity else "conditioned"
    cloud(plot, np.asarray(c), np.asarray(s), "after", name)
    return plot.svg()


def is_dense(sine: FloatArray) -> bool:
    """Whether :func:`lissajous` shows the density of these samples in place of each one."""
    return int(np.isfinite(sine).sum()) > SHOWN_SAMPLES


def square_plot(title: str, most_counts: float) -> Plot:
    """Axes for both tracks, -``most_counts``..``most_counts``, with the same scale on both."""
    extent = (-most_counts, most_counts)
    names = "cosine, ADC counts", "sine, ADC counts"
    return Plot(title, extent, extent, names, size_around(SIDE, SIDE))


def cloud(plot: Plot, x: FloatArray, y: FloatArray, style: str, name: str) -> None:
    """Each sample as a dot, or, of many, one for each small cell that has samples: darker for more."""
    if len(x) <= SHOWN_SAMPLES:
        plot.dots(x, y, style, name)
        return
    for cells in DENSITY_CELLS:
        place = _cell(x, plot.x, cells) * cells + _cell(y, plot.y, cells)
        _, place, count = np.unique(place, return_inverse=True, return_counts=True)
        if len(count) <= SHOWN_SAMPLES:
            break
    x, y = np.bincount(place, x) / count, np.bincount(place, y) / count
    level = np.ceil(SHADES * np.log1p(count) / np.log1p(count.max()))
    for shade in range(1, SHADES + 1):
        chosen = level == shade
        opacity = FAINTEST + (1.0 - FAINTEST) * shade / SHADES
        plot.dots(x[chosen], y[chosen], style, name if shade == SHADES else None, opacity)


def circle(plot: Plot, radius: float, style: str, name: str | None) -> None:
    """A circle about the origin, ``radius`` in counts."""
    angle = np.linspace(0.0, 2.0 * np.pi, 361)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    outside = np.maximum(np.abs(x), np.abs(y)) > plot.x.high
    plot.line(x, np.where(outside, np.nan, y), style, name)


def box(plot: Plot, half: float) -> None:
    """The ends of the converter, ``half`` in counts."""
    plot.line(
        np.array([-half, half, half, -half, -half]),
        np.array([-half, -half, half, half, -half]),
        "limit",
        "ends of the converter",
    )


def _cell(values: FloatArray, scale: Scale, cells: int) -> npt.NDArray[np.int64]:
    """Number of the cell along one axis, 0..cells - 1."""
    part = (values - scale.low) / (scale.high - scale.low)
    return np.clip((part * cells).astype(np.int64), 0, cells - 1)


RESIDUAL_BINS = 150
MOST_POINTS = 600  # of a curve over time: each is the lowest and the highest value of a stretch


def residual_histogram(residual: FloatArray, before: float, new: float) -> str:
    """Size of the residuals, cycles, NaN where there is none, with the limit before and the new one."""
    sizes = np.abs(residual[np.isfinite(residual)])
    most = 1.08 * max(before, new, float(sizes.max(initial=0.0)))
    count, edges = np.histogram(sizes, RESIDUAL_BINS, (0.0, most))
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
    known = over_phase[np.isfinite(over_phase)]
    top = 1.08 * max(high, float(known.max(initial=0.0)))
    bottom = 0.92 * min(low, float(known.min(initial=low)))
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
