"""Small plots as SVG."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import NamedTuple, Self

import numpy as np

from canfb.signal.phase import FloatArray

LEFT, RIGHT, TOP, BOTTOM = 78.0, 14.0, 12.0, 44.0
RING_RADIUS = 6.0


class Key(NamedTuple):
    """An entry of the legend; ``kind``: "line", "dot", "bar" or "ring"."""

    name: str
    style: str
    kind: str


class Plot:
    """One picture; drawing methods return it. ``style``: a CSS class, ``name``: in the legend."""

    def __init__(
        self,
        title: str,
        x: tuple[float, float],
        y: tuple[float, float],
        labels: tuple[str, str],
        size: tuple[float, float] = (520.0, 300.0),
        log_y: bool = False,
    ) -> None:
        self.width, self.height = size
        self.x = Scale(*x, LEFT, self.width - RIGHT)
        self.y = Scale(*y, self.height - BOTTOM, TOP, log_y)
        self.title = title
        self.legend: list[Key] = []
        self._labels = labels
        self._parts: list[str] = []

    def line(self, xs: FloatArray, ys: FloatArray, style: str, name: str | None = None) -> Self:
        """A line, interrupted at NaN."""
        path, pen = [], "M"
        for one, other in zip(xs.tolist(), ys.tolist(), strict=True):
            if math.isfinite(other):
                path.append(f"{pen}{self.x(one):.1f} {self.y(other):.1f}")
                pen = "L"
            else:
                pen = "M"
        return self._draw(f'<path class="line {style}" d="{"".join(path)}"/>', style, name, "line")

    def dots(
        self,
        xs: FloatArray,
        ys: FloatArray,
        style: str,
        name: str | None = None,
        opacity: float | None = None,
    ) -> Self:
        """Dots, as one path, which keeps the page small."""
        path = "".join(
            f"M{self.x(one):.1f} {self.y(other):.1f}h0"
            for one, other in zip(xs.tolist(), ys.tolist(), strict=True)
        )
        faint = "" if opacity is None else f' style="stroke-opacity:{opacity:.2f}"'
        return self._draw(f'<path class="dots {style}"{faint} d="{path}"/>', style, name, "dot")

    def bars(self, xs: FloatArray, ys: FloatArray, width: float, style: str, name: str | None = None) -> Self:
        """Bars, ``width`` in units of x."""
        bottom = self.y(self.y.low)
        parts = []
        for one, other in zip(xs.tolist(), ys.tolist(), strict=True):
            if math.isfinite(other) and self.y(other) < bottom:
                left, right, top = self.x(one - width / 2.0), self.x(one + width / 2.0), self.y(other)
                parts.append(f"M{left:.1f} {bottom:.1f}V{top:.1f}H{right:.1f}V{bottom:.1f}Z")
        return self._draw(f'<path class="bar {style}" d="{"".join(parts)}"/>', style, name, "bar")

    def level(self, value: float, name: str | None = None) -> Self:
        if self.y.low <= value <= self.y.high:
            self.line(np.array([self.x.low, self.x.high]), np.full(2, value), "limit dashed", name)
        return self

    def rings(self, xs: FloatArray, ys: FloatArray, style: str, name: str | None = None) -> Self:
        circles = "".join(
            f'<circle class="ring {style}" cx="{self.x(one):.1f}" cy="{self.y(other):.1f}" '
            f'r="{RING_RADIUS:g}"/>'
            for one, other in zip(xs.tolist(), ys.tolist(), strict=True)
        )
        return self._draw(circles, style, name, "ring")

    def note(self, x: float, y: float, words: str, style: str, offset: tuple[float, float]) -> Self:
        """Words at ``offset`` (right, down) from a point; style "end": right-aligned."""
        self._parts.append(_text(self.x(x) + offset[0], self.y(y) + offset[1], f"note {style}", words))
        return self

    def svg(self) -> str:
        return (
            f'<svg viewBox="0 0 {self.width:g} {self.height:g}" role="img" '
            f'aria-label="{escape(self.title)}">{self.drawing()}</svg>{self._legend_html()}'
        )

    def drawing(self) -> str:
        """The elements within the SVG, without the legend."""
        return f"{self._grid()}{''.join(self._parts)}{self._axis_labels()}"

    def _draw(self, part: str, style: str, name: str | None, kind: str) -> Self:
        self._parts.append(part)
        if name:
            self.legend.append(Key(name, style, kind))
        return self

    def _grid(self) -> str:
        bottom, top = self.y(self.y.low), self.y(self.y.high)
        left, right = self.x(self.x.low), self.x(self.x.high)
        upright = [
            f'<path class="grid" d="M{self.x(value):.1f} {bottom:.1f}V{top:.1f}"/>'
            f"{_text(self.x(value), bottom + 16.0, 'tick mid', tick_words(value))}"
            for value in self.x.ticks()
        ]
        level = [
            f'<path class="grid" d="M{left:.1f} {self.y(value):.1f}H{right:.1f}"/>'
            f"{_text(left - 6.0, self.y(value) + 4.0, 'tick end', tick_words(value))}"
            for value in self.y.ticks()
        ]
        axis = f'<path class="axis" d="M{left:.1f} {top:.1f}V{bottom:.1f}H{right:.1f}"/>'
        return "".join([*upright, *level, axis])

    def _axis_labels(self) -> str:
        middle = (self.y(self.y.low) + self.y(self.y.high)) / 2.0
        across = (self.x(self.x.low) + self.x(self.x.high)) / 2.0
        return (
            f"{_text(across, self.height - 8.0, 'label mid', self._labels[0])}"
            f'<text transform="translate(13 {middle:.1f}) rotate(-90)" class="label mid">'
            f"{escape(self._labels[1])}</text>"
        )

    def _legend_html(self) -> str:
        items = "".join(
            f'<span><i class="{key.kind}-key {key.style}"></i>{escape(key.name)}</span>'
            for key in self.legend
        )
        return f'<div class="legend">{items}</div>' if items else ""


def _text(x: float, y: float, style: str, words: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" class="{style}">{escape(words)}</text>'


TICK_COUNT = 5
FEWER = 0.8  # a step may be this part of the ideal one: rather seven ticks than three


class Scale:
    """A linear or logarithmic axis."""

    def __init__(self, low: float, high: float, start: float, stop: float, log: bool = False) -> None:
        if not high > low:
            high = low + (abs(low) or 1.0)
        self.low, self.high, self.log = low, high, log
        self._start, self._stop = start, stop

    def __call__(self, value: float) -> float:
        """Place of ``value`` in the picture, limited to a margin around the axis."""
        if self.log:
            part = math.log10(max(value, self.low) / self.low) / math.log10(self.high / self.low)
        else:
            part = (value - self.low) / (self.high - self.low)
        return self._start + min(max(part, -0.02), 1.02) * (self._stop - self._start)

    def ticks(self) -> list[float]:
        if self.log:
            first, last = math.ceil(math.log10(self.low) - 1e-9), math.floor(math.log10(self.high) + 1e-9)
            return [10.0**power for power in range(first, last + 1)]
        rough = (self.high - self.low) / TICK_COUNT
        power = 10.0 ** math.floor(math.log10(rough))
        step = next(one * power for one in (1.0, 2.0, 2.5, 5.0, 10.0) if one * power >= rough * FEWER)
        first = math.ceil(self.low / step - 1e-9)
        return [n * step for n in range(first, math.floor(self.high / step + 1e-9) + 1)]


def nice_limit(values: Sequence[float] | FloatArray, least: float = 0.0) -> float:
    """A little more than the largest finite size, at least ``least``."""
    sizes = np.abs(np.asarray(values, np.float64))
    sizes = sizes[np.isfinite(sizes)]
    return max(1.1 * float(sizes.max()) if len(sizes) else 0.0, least, 1e-12)


def tick_words(value: float) -> str:
    if value == 0.0:
        return "0"
    if 1e-4 <= abs(value) < 1e5:
        return f"{value:.6g}"
    power = math.floor(math.log10(abs(value)) + 1e-9)
    return f"{value / 10.0**power:.3g}e{power}"
