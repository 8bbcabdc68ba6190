"""The pictures of a report, as SVG; errors in cycles, curves over the phase of BINS values or NaN."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from canfb.calibration.result import BINS, root_mean
from canfb.report.plot import BOTTOM, LEFT, RIGHT, TOP, Plot, Scale, nice_limit
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import CorrectionTable
from canfb.signal.phase import FloatArray, IntArray, wrap
from canfb.signal.supervision import SampleLimits

PERCENT = 100.0
PHASES = (np.arange(BINS) + 0.5) / BINS
ERROR_LABELS = "phase, cycles", "error, % of a cycle"
CYCLE = 0.0, 1.0


def error_over_phase(before: FloatArray, after: FloatArray) -> str:
    most = PERCENT * nice_limit(np.concatenate([before, after]))
    plot = Plot("Mean error over the phase, before and after", CYCLE, (-most, most), ERROR_LABELS)
    plot.line(PHASES, PERCENT * before, "before", "before")
    return plot.line(PHASES, PERCENT * after, "after", "after").svg()


def remaining_error(after: FloatArray, uncertainty: float) -> str:
    most = PERCENT * nice_limit(after, 1.3 * uncertainty)
    plot = Plot("Remaining mean error over the phase", CYCLE, (-most, most), ERROR_LABELS)
    plot.line(PHASES, PERCENT * after, "after", "after, mean of each 1/64 cycle")
    plot.level(PERCENT * uncertainty, "uncertainty of the table")
    return plot.level(-PERCENT * uncertainty).svg()


def rms_over_speed(speed: FloatArray, before: FloatArray, after: FloatArray, unit: str) -> str:
    """Rms errors, shape (n,); NaN: position lost."""
    values = np.concatenate([before, after])
    values = values[np.isfinite(values) & (values > 0.0)] if np.any(values > 0.0) else np.array([1e-4])
    extent = _decades(PERCENT * float(values.min()), 1.01 * PERCENT * float(values.max()))
    return _over_speed("Rms error", extent, speed, (before, after), unit, log_y=True)


def mean_over_speed(speed: FloatArray, before: FloatArray, after: FloatArray, unit: str) -> str:
    """Mean errors, shape (n,); NaN: not known."""
    most = PERCENT * nice_limit(np.concatenate([before, after]), 1e-5)
    return _over_speed("Mean error", (-most, most), speed, (before, after), unit)


def _over_speed(
    what: str,
    extent: tuple[float, float],
    speed: FloatArray,
    errors: tuple[FloatArray, FloatArray],
    unit: str,
    log_y: bool = False,
) -> str:
    span = min(0.0, 1.05 * float(speed.min())), max(0.0, 1.05 * float(speed.max()))
    labels = f"speed, {unit}", f"{what.lower()}, % of a cycle"
    plot = Plot(f"{what} over the speed, before and after", span, extent, labels, log_y=log_y)
    for values, style in zip(errors, ("before", "after"), strict=True):
        known = np.isfinite(values)
        plot.line(speed[known], PERCENT * values[known], style, style)
        plot.dots(speed[known], PERCENT * values[known], style)
    return plot.svg()


def _decades(low: float, high: float) -> tuple[float, float]:
    return float(10.0 ** np.floor(np.log10(low))), float(10.0 ** np.ceil(np.log10(high)))


HIGHEST_ORDER = 20


def harmonics(before: FloatArray, after: FloatArray, noise_rms: float, samples: int) -> str:
    place = np.arange(1.0, HIGHEST_ORDER + 1.0)
    old, new = (PERCENT * _amplitudes(curve)[1 : HIGHEST_ORDER + 1] for curve in (before, after))
    floor = PERCENT * 2.0 * noise_rms / np.sqrt(max(1, samples))
    low = max(float(np.min(new)), 0.3 * floor, 1e-7)
    extent = _decades(low, max(float(old.max()), float(new.max()), 10.0 * low))
    labels = "harmonic of the cycle", "amplitude, % of a cycle"
    title = "Harmonics of the error, before and after"
    plot = Plot(title, (0.3, HIGHEST_ORDER + 0.7), extent, labels, log_y=True)
    plot.bars(place - 0.2, old, 0.36, "before", "before").bars(place + 0.2, new, 0.36, "after", "after")
    return plot.level(floor, "level of noise alone").svg()


def _amplitudes(curve: FloatArray) -> FloatArray:
    known = np.isfinite(curve)
    if not known.any():
        return np.zeros(BINS // 2 + 1)
    place = np.arange(BINS)
    filled = np.interp(place, place[known], curve[known], period=BINS)
    # The mean over a bin attenuates higher orders slightly: correct for it.
    spectrum = np.abs(np.fft.rfft(filled)) / BINS * 2.0
    return np.asarray(spectrum / np.sinc(np.arange(len(spectrum)) / BINS), np.float64)


HISTOGRAM_BINS, RESIDUAL_BINS = 48, 150
SIGMAS = 5.0


def histogram(error: FloatArray, rms: float, noise_cycles: float) -> str:
    """Deviation of single samples, shape (n,), and the distribution of noise alone; ``rms``: corrected."""
    span = SIGMAS * max(rms, noise_cycles, 1e-9)
    # The cubic in each block removes some noise: apply the same correction as in the rms.
    error = error * (rms / max(root_mean(error), 1e-15))
    count, middle, width = _counted(error, HISTOGRAM_BINS, (-span, span))
    sigma = max(noise_cycles, 1e-12)
    density = np.exp(-0.5 * (middle / sigma) ** 2) / (sigma * np.sqrt(2.0 * np.pi))
    noise = np.asarray(len(error) * width * density, np.float64)
    labels = "deviation of a sample, % of a cycle", "samples"
    extent = 0.0, 1.1 * max(float(count.max()), float(noise.max()), 1.0)
    title = "Histogram of the deviation of single samples, with the noise"
    plot = Plot(title, (-PERCENT * span, PERCENT * span), extent, labels)
    plot.bars(PERCENT * middle, count, 0.92 * PERCENT * width, "after", "samples")
    return plot.line(PERCENT * middle, noise, "limit", "noise of the measurement, alone").svg()


def residual_histogram(residual: FloatArray, before: float, new: float) -> str:
    """Residuals, cycles or NaN, with the limit before and the new one."""
    sizes = np.abs(residual[np.isfinite(residual)])
    most = 1.08 * max(before, new, float(sizes.max(initial=0.0)))
    count, middle, width = _counted(sizes, RESIDUAL_BINS, (0.0, most))
    _, top = _decades(1.0, max(float(count.max()), 10.0))
    title = "Histogram of the residual of single samples, with the limits"
    plot = Plot(title, (0.0, most), (0.5, top), ("residual, cycles", "samples"), log_y=True)
    plot.bars(middle, np.where(count, count, np.nan), 0.92 * width, "after", "samples")
    for limit, style, name in ((before, "before", "before"), (new, "limit", "proposed")):
        plot.line(np.full(2, limit), np.array([0.5, top]), f"{style} dashed", f"residual limit {name}")
    return plot.svg()


def _counted(
    values: FloatArray, bins: int, extent: tuple[float, float]
) -> tuple[FloatArray, FloatArray, float]:
    """Counts, centres and width of bins."""
    count, edges = np.histogram(values, bins, extent)
    middle = np.asarray((edges[:-1] + edges[1:]) / 2.0, np.float64)
    return count.astype(np.float64), middle, float(edges[1] - edges[0])


def coverage(samples: IntArray) -> str:
    """Samples in each 1/64 cycle, shape (64,)."""
    count = samples.astype(np.float64)
    extent = 0.0, 1.15 * max(float(count.max()), 1.0)
    plot = Plot("Samples over the phase", CYCLE, extent, ("phase, cycles", "samples in 1/64 cycle"))
    plot.bars(PHASES, count, 0.9 / BINS, "after", "used")
    return plot.level(float(count.sum()) / BINS, "even coverage").svg()


def table_curve(table: CorrectionTable, before: CorrectionTable | None) -> str:
    place = np.arange(512) / 512.0
    curves = ("before", "table before", before), ("after", "new table", table)
    lines = [
        (style, name, PERCENT * wrap(one(place) - place)) for style, name, one in curves if one is not None
    ]
    most = nice_limit(np.concatenate([line for _, _, line in lines]))
    labels = "raw phase, cycles", "correction, % of a cycle"
    plot = Plot("Correction over the raw phase", CYCLE, (-most, most), labels)
    for style, name, line in lines:
        plot.line(place, line, style, name)
    return plot.svg()


def amplitude_over_phase(over_phase: FloatArray, low: float, high: float) -> str:
    """Lowest, mean, highest in each 1/64 cycle, counts, shape (3, 64)."""
    known = over_phase[np.isfinite(over_phase)]
    extent = 0.92 * min(low, float(known.min(initial=low))), 1.08 * max(high, float(known.max(initial=0.0)))
    labels = "phase, cycles", "amplitude, counts"
    plot = Plot("Amplitude over the phase, with its limits", CYCLE, extent, labels)
    lowest, mean, highest = over_phase
    plot.line(PHASES, lowest, "after thin", "lowest and highest").line(PHASES, highest, "after thin")
    plot.line(PHASES, mean, "after", "mean").level(low, "amplitude limits proposed")
    return plot.level(high).svg()


SHOWN_SAMPLES = 4000
DENSITY_CELLS = (300, 150, 60)  # cells per side; the first number with few enough dots is used
SHADES, FAINTEST = 5, 0.3
SQUARE = 394.0 + LEFT + RIGHT, 394.0 + TOP + BOTTOM  # square within the axes, so that circles stay round


def lissajous(
    sine: FloatArray, cosine: FloatArray, conditioning: Conditioning, limits: SampleLimits | None
) -> str:
    """Samples, shape (n,), ADC counts or NaN, raw and conditioned, with limits and ends of the converter."""
    known = np.isfinite(sine)
    sine, cosine = sine[known], cosine[known]
    s, c = (np.asarray(one) for one in conditioning.apply(sine, cosine))
    ends = [] if limits is None else [1.02 * limits.full_scale_counts]
    plot = square_plot(
        "Lissajous figure: sine over cosine, raw and conditioned, with the limits of the amplitude",
        max([nice_limit(values) for values in (sine, cosine, s, c)] + ends),
    )
    if limits is not None:
        corners = limits.full_scale_counts * np.array([-1.0, 1.0, 1.0, -1.0, -1.0])
        plot.line(corners, np.roll(corners, 1), "limit", "ends of the converter")
        circle(plot, limits.amplitude_low_counts, "limit dashed", "amplitude limits")
        circle(plot, limits.amplitude_high_counts, "limit dashed", None)
    if conditioning.is_identity:
        return cloud(plot, cosine, sine, "after", "raw").svg()
    cloud(plot, cosine, sine, "before", "raw")
    return cloud(plot, c, s, "after", "conditioned").svg()


def square_plot(title: str, most_counts: float) -> Plot:
    """Axes for both tracks, -``most_counts``..``most_counts``."""
    extent = (-most_counts, most_counts)
    return Plot(title, extent, extent, ("cosine, ADC counts", "sine, ADC counts"), SQUARE)


def cloud(plot: Plot, x: FloatArray, y: FloatArray, style: str, name: str) -> Plot:
    """A dot for each sample, or for many samples one for each small cell: the more the darker."""
    if len(x) <= SHOWN_SAMPLES:
        return plot.dots(x, y, style, name)
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
    return plot


def circle(plot: Plot, radius: float, style: str, name: str | None) -> Plot:
    angle = np.linspace(0.0, 2.0 * np.pi, 361)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    outside = np.maximum(np.abs(x), np.abs(y)) > plot.x.high
    return plot.line(x, np.where(outside, np.nan, y), style, name)


def _cell(values: FloatArray, scale: Scale, cells: int) -> IntArray:
    part = (values - scale.low) / (scale.high - scale.low)
    return np.clip((part * cells).astype(np.int64), 0, cells - 1)


MOST_POINTS = 600  # points of a curve over time: the lowest and the highest value of a stretch each


def acceleration_over_time(acceleration: FloatArray, interval_s: float, largest: float) -> str:
    """rad/s², NaN: not known; ``largest`` 0: no limit."""
    parts = np.array_split(acceleration, min(MOST_POINTS, max(1, len(acceleration))))
    known = [part[np.isfinite(part)] for part in parts]
    ends = np.array([(part.min(), part.max()) if len(part) else (np.nan, np.nan) for part in known])
    last_s = len(acceleration) * interval_s
    time_s = (np.arange(len(parts)) + 0.5) / len(parts) * last_s
    most = nice_limit(ends.reshape(-1), 1.1 * largest)
    labels = "time, s", "acceleration, rad/s²"
    extent = 0.0, max(last_s, interval_s)
    plot = Plot("Acceleration over time, with its limit", extent, (-most, most), labels)
    plot.line(np.repeat(time_s, 2), ends.reshape(-1), "after thin", "machine")
    if largest:
        plot.level(largest, "largest acceleration proposed").level(-largest)
    return plot.svg()


ROOM = 0.06  # margin above and below the curves, part of the height


class Curve(NamedTuple):
    """A curve; NaN: no value."""

    values: FloatArray
    style: str
    name: str | None


def over_time(
    title: str, label: str, time_s: FloatArray, curves: Sequence[Curve], least: float | None = None
) -> str:
    """Curves over ``time_s``, seconds; the axis includes ``least``."""
    values = np.concatenate([curve.values for curve in curves])
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    room = ROOM * (high - low) or abs(high) or 1.0
    extent = low - room if least is None else least, high + room
    last_s = float(time_s[-1]) if len(time_s) else 1.0
    plot = Plot(title, (0.0, last_s or 1.0), extent, ("time from the beginning of the log, s", label))
    for curve in curves:
        draw = plot.dots if len(time_s) == 1 else plot.line
        draw(time_s, curve.values, curve.style, curve.name)
    return plot.svg()
