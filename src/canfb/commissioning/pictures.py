"""The pictures of a report: what a drive engineer looks at to trust a table, or not to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from canfb.calibration.evaluate import root_mean
from canfb.calibration.recording import BINS
from canfb.calibration.result import Calibration
from canfb.commissioning.active import ActiveSet
from canfb.commissioning.deviation import Deviation
from canfb.commissioning.samples import Samples
from canfb.report.plot import Plot, Scale, nice_limit
from canfb.signal.phase import FloatArray

SHOWN_SAMPLES = 4000
DENSITY_CELLS = (300, 150, 60)  # to the side of the picture; the first that makes no more dots than that
SHADES, FAINTEST = 5, 0.3
HIGHEST_ORDER = 20
PERCENT = 100.0
HISTOGRAM_BINS = 48
SIGMAS = 5.0


@dataclass(frozen=True)
class TrackLimits:
    """Limits of the module's checks, counts: 2001:02, 2001:03, 2001:04."""

    full_scale: int
    amplitude_low: float
    amplitude_high: float


def lissajous(samples: Samples, used: ActiveSet, limits: TrackLimits | None) -> str:
    """Raw and conditioned samples, the circles of the amplitude limits, the ends of the converter.

    Each sample is a dot; more than 4000 are shown by their density, so that none is left out.
    """
    seen = np.isfinite(samples.sine)
    sine, cosine = samples.sine[seen], samples.cosine[seen]
    s, c = used.conditioning.apply(sine, cosine)
    extent = [nice_limit(values) for values in (sine, cosine, s, c)]
    if limits is not None:
        extent += [1.02 * limits.full_scale]
    most = max(extent)
    plot = Plot(
        "Lissajous picture: sine over cosine, raw and conditioned, with the limits of the amplitude",
        (-most, most),
        (-most, most),
        ("cosine, ADC counts", "sine, ADC counts"),
        (480.0, 460.0),
    )
    if limits is not None:
        _box(plot, float(limits.full_scale))
        _circle(plot, limits.amplitude_low, "limit dashed", "amplitude limits")
        _circle(plot, limits.amplitude_high, "limit dashed", None)
    if not used.conditioning.is_identity:
        _cloud(plot, cosine, sine, "before", "raw")
    name = "raw" if used.conditioning.is_identity else "conditioned"
    _cloud(plot, np.asarray(c), np.asarray(s), "after", name)
    return plot.svg()


def is_dense(samples: Samples) -> bool:
    """Whether :func:`lissajous` shows their density in place of each sample."""
    return len(samples) - samples.missed > SHOWN_SAMPLES


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
    plot.level(PERCENT * uncertainty, "limit dashed", "what the table is good to")
    plot.level(-PERCENT * uncertainty, "limit dashed")
    return plot.svg()


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
    plot.level(floor, "limit dashed", "what noise alone leaves")
    return plot.svg()


def histogram(found: Deviation, noise_cycles: float) -> str:
    """Deviation of single samples with the table, and what noise alone would give."""
    span = SIGMAS * max(found.rms, noise_cycles, 1e-9)
    # A cubic through each block takes some of the noise with it: the same factor as in the rms.
    error = found.error * (found.rms / max(root_mean(found.error), 1e-15))
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


def coverage(found: Deviation) -> str:
    """Samples in each 1/64 of the cycle."""
    count = found.samples_over_phase().astype(np.float64)
    plot = Plot(
        "Samples over the phase",
        (0.0, 1.0),
        (0.0, 1.15 * max(float(count.max()), 1.0)),
        ("phase, cycles", "samples in 1/64 cycle"),
    )
    plot.bars((np.arange(BINS) + 0.5) / BINS, count, 0.9 / BINS, "after", "used")
    plot.level(len(found.phase) / BINS, "limit dashed", "even coverage")
    return plot.svg()


def table_curve(calibration: Calibration, before: ActiveSet) -> str:
    """The correction itself: phase less raw phase, of the new table and of the one before."""
    place = np.arange(513) / 512.0
    curves = [("after", "new table", calibration.table)]
    if before.table is not None:
        curves.insert(0, ("before", "table before", before.table))
    lines = [
        (style, name, PERCENT * _correction(table(place[:-1]), place[:-1])) for style, name, table in curves
    ]
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


def _correction(phase: FloatArray, raw: FloatArray) -> FloatArray:
    return np.asarray((phase - raw + 0.5) % 1.0 - 0.5, np.float64)


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


def _cloud(plot: Plot, x: FloatArray, y: FloatArray, style: str, name: str) -> None:
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


def _cell(values: FloatArray, scale: Scale, cells: int) -> NDArray[np.int64]:
    """Number of the cell along one axis, 0..cells - 1."""
    part = (values - scale.low) / (scale.high - scale.low)
    return np.clip((part * cells).astype(np.int64), 0, cells - 1)


def _circle(plot: Plot, radius: float, style: str, name: str | None) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 361)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    outside = np.maximum(np.abs(x), np.abs(y)) > plot.x.high
    plot.line(x, np.where(outside, np.nan, y), style, name)


def _box(plot: Plot, half: float) -> None:
    plot.line(
        np.array([-half, half, half, -half, -half]),
        np.array([-half, -half, half, half, -half]),
        "limit",
        "ends of the converter",
    )
