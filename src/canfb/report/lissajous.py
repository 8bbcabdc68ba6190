"""The Lissajous figure: sine over cosine."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from canfb.report.plot import Plot, size_around
from canfb.report.scale import Scale, nice_limit
from canfb.signal.conditioning import Conditioning
from canfb.signal.phase import FloatArray
from canfb.signal.supervision import SampleLimits

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
    seen = np.isfinite(sine)
    sine, cosine = sine[seen], cosine[seen]
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
