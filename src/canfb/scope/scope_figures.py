"""The pictures of the page, as figures of Bokeh, and what goes into them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, Range1d
from bokeh.plotting import figure

from canfb.monitoring.lines import RPM, MachineUnits
from canfb.monitoring.module_model import HISTORY_BINS
from canfb.monitoring.snapshot import ModuleSnapshot
from canfb.scope.desk import MeasuredCurves
from canfb.scope.traces import LONGEST_S, PERCENT, DeviationCurve, ModuleTraces
from canfb.signal.phase import FloatArray

BLUE, ORANGE, RED, GREY = "#3b82f6", "#d97706", "#e5484d", "#8b949e"  # visible on light and on dark
INK, FAINT, GRID = ("#1d2b33", "#e6edf3"), ("#5c6b74", "#9aa7b1"), ("#e3e8eb", "#30363d")  # light, dark
SQUARE, MARGINS, HEIGHT = 240, (90, 55), 230
HEADROOM = 1.15
READ, ASSUMED = "dashed", "dotted"  # lines of limits that were read from the module, or not
PICTURES = ("lissajous", "deviation", "residual", "position", "velocity", "measured")
MARGIN, LEAST_SPAN = 0.06, 1e-3
LEAST_LIMIT = 0.02


class ScopeFigures:
    """All pictures of one page; :meth:`show` puts the traces of a module into them."""

    def __init__(self, units: MachineUnits) -> None:
        self._per_revolution = units.per_revolution
        self._per_rad_s = RPM if units.name == "rev" else units.per_revolution / (2.0 * math.pi)
        velocity = "rpm" if units.name == "rev" else f"{units.name}/s"
        self.lissajous = _figure(
            "cosine, counts",
            "sine, counts",
            sizing_mode="fixed",
            frame_width=SQUARE,
            frame_height=SQUARE,
            width=SQUARE + MARGINS[0],
            height=SQUARE + MARGINS[1],
        )
        self.deviation = _figure("phase, cycles", "deviation, % of a cycle", x_range=Range1d(0.0, 1.0))
        self.residual = _figure("time, s", "residual, cycles", y_range=Range1d(0.0, 0.5))
        self.position = _figure("time, s", f"position, {units.name}", x_range=Range1d(-LONGEST_S, 0.0))
        self.velocity = _figure("time, s", f"velocity, {velocity}", x_range=self.position.x_range)
        self.measured = _figure(
            "phase, cycles", "deviation, % of a cycle", x_range=Range1d(0.0, 1.0), visible=False
        )
        self._measured = _source("phase", "before", "after")
        self._curves: MeasuredCurves | None = None
        self._tracks = _source("cosine", "sine")
        self._limits = _source("x", "y")
        self._samples = _source("phase", "deviation")
        self._means = _source("phase", "before", "after")
        self._peaks = _source("time", "peak")
        self._limit = _source("time", "limit")
        self._points = _source("time", "position", "velocity")
        self._curve: DeviationCurve | None = None
        self._draw()

    def _draw(self) -> None:
        self._circles = self.lissajous.multi_line("x", "y", source=self._limits, color=GREY, line_dash=READ)
        self.lissajous.scatter("cosine", "sine", source=self._tracks, size=3, color=BLUE)
        self.deviation.scatter("phase", "deviation", source=self._samples, size=2, color=GREY, alpha=0.5)
        self.deviation.line("phase", "before", source=self._means, color=ORANGE, line_width=2)
        self.deviation.line("phase", "after", source=self._means, color=BLUE, line_width=2)
        self.measured.line("phase", "before", source=self._measured, color=ORANGE, line_width=2)
        self.measured.line("phase", "after", source=self._measured, color=BLUE, line_width=2)
        self.residual.vbar("time", top="peak", width=0.45, source=self._peaks, color=BLUE)
        self._dashes = self.residual.line(
            "time", "limit", source=self._limit, color=RED, line_width=2, line_dash=READ, name="limit"
        )
        self.position.line("time", "position", source=self._points, color=BLUE, line_width=2)
        self.velocity.line("time", "velocity", source=self._points, color=BLUE, line_width=2)

    @property
    def roots(self) -> dict[str, Any]:
        """The pictures by name."""
        return {name: getattr(self, name) for name in PICTURES}

    def dress(self, *, dark: bool) -> None:
        """Lines and texts for a dark or a light page; a theme of Bokeh does not change what is drawn."""
        ink, faint, grid = INK[dark], FAINT[dark], GRID[dark]
        for shown in self.roots.values():
            shown.outline_line_color = grid
            shown.grid.grid_line_color = grid
            for axis in shown.axis:
                axis.update(
                    axis_label_text_color=ink,
                    major_label_text_color=faint,
                    axis_line_color=faint,
                    major_tick_line_color=faint,
                )

    def show(self, traces: ModuleTraces, now: float) -> None:
        """What there is of a module, ``now`` in seconds."""
        module = traces.module
        if module is None:
            return
        self._show_tracks(module)
        self._show_residual(module)
        times, positions, velocities = np.array(traces.points, np.float64).reshape(-1, 3).T
        positions, velocities = positions * self._per_revolution, velocities * self._per_rad_s
        self._points.data = {"time": times - now, "position": positions, "velocity": velocities}
        _fit(self.position.y_range, positions)
        _fit(self.velocity.y_range, velocities)
        curve = traces.deviation(now)
        if curve is not self._curve:
            self._curve = curve
            self._samples.data = {"phase": curve.phase, "deviation": curve.deviation}
            after = curve.mean if curve.with_table else np.full_like(curve.mean, np.nan)
            self._means.data = {"phase": curve.centers, "before": curve.before, "after": after}
            _fit(self.deviation.y_range, np.concatenate([curve.deviation, curve.before]))

    def show_measured(self, curves: MeasuredCurves | None) -> None:
        """What a reference measurement has found; None: no picture."""
        if curves is self._curves:
            return
        self._curves = curves
        self.measured.visible = curves is not None
        if curves is not None:
            before, after = PERCENT * curves.before, PERCENT * curves.after
            phase = (np.arange(len(before)) + 0.5) / max(1, len(before))
            self._measured.data = {"phase": phase, "before": before, "after": after}
            _fit(self.measured.y_range, np.concatenate([before, after]))

    def _show_tracks(self, module: ModuleSnapshot) -> None:
        sine, cosine = np.array(module.tracks_counts, np.float64).reshape(-1, 2).T
        self._tracks.data = {"cosine": cosine, "sine": sine}
        limit = float(module.full_scale_counts or max([1.0, *np.abs(sine), *np.abs(cosine)]))
        if self.lissajous.x_range.end != limit:
            for axis in (self.lissajous.x_range, self.lissajous.y_range):
                axis.update(start=-limit, end=limit)
        angle = np.linspace(0.0, 2.0 * np.pi, 121)
        circles = [radius for radius in module.amplitude_limits_counts if radius > 0]
        limits = {
            "x": [radius * np.cos(angle) for radius in circles],
            "y": [radius * np.sin(angle) for radius in circles],
        }
        drawn = [float(x[0]) for x in self._limits.data["x"]]
        if drawn != [float(radius) for radius in circles]:
            self._limits.data = limits
        self._mark(self._circles, "amplitude_limits_counts", module)

    def _mark(self, drawn: Any, name: str, module: ModuleSnapshot) -> None:
        """A limit that was not read is dotted."""
        if drawn.tags != [dash := ASSUMED if name in module.assumed else READ]:
            drawn.tags = [dash]
            drawn.glyph.line_dash = dash

    def _show_residual(self, module: ModuleSnapshot) -> None:
        highest = max((one for one in module.residual_history_cycles if one is not None), default=0.0)
        peaks = [math.nan if one is None else one for one in module.residual_history_cycles]
        bin_s = module.history_bin_s or 1.0
        peaks = [math.nan] * (HISTORY_BINS - len(peaks)) + peaks
        times = (np.arange(len(peaks)) - len(peaks) + 0.5) * bin_s
        self._peaks.data = {"time": times, "peak": np.array(peaks, np.float64)}
        self._mark(self._dashes, "residual_limit_cycles", module)
        limit = module.residual_limit_cycles or 0.5
        ends = (float(-len(peaks) * bin_s), 0.0)
        drawn = {"time": list(ends), "limit": [limit, limit]}
        if self._limit.data != drawn:
            self._limit.data = drawn
            self.residual.x_range.start = ends[0]
        self.residual.y_range.end = HEADROOM * max(limit, highest, LEAST_LIMIT)


def _figure(x: str, y: str, **options: Any) -> Any:
    usual: dict[str, Any] = {"sizing_mode": "stretch_width", "height": HEIGHT}
    usual |= {"x_range": Range1d(-1.0, 0.0), "y_range": Range1d(-1.0, 1.0)}
    shown = figure(
        x_axis_label=x,
        y_axis_label=y,
        toolbar_location=None,
        tools="",
        min_border_right=16,
        **(usual | options),
    )
    shown.background_fill_alpha = shown.border_fill_alpha = 0.0
    shown.yaxis.formatter.use_scientific = False
    shown.axis.axis_label_text_font_style = "normal"
    shown.axis.minor_tick_line_color = None
    shown.xaxis.ticker.desired_num_ticks = shown.yaxis.ticker.desired_num_ticks = 5
    return shown


def _source(*columns: str) -> ColumnDataSource:
    return ColumnDataSource({column: [] for column in columns})


def _fit(shown: Range1d, values: FloatArray) -> None:
    """All values in the range; it only moves where they leave it, or fill less than half of it."""
    values = values[np.isfinite(values)]
    if not len(values):
        return
    low, high = float(values.min()), float(values.max())
    span = max(high - low, LEAST_SPAN)
    if not (shown.start <= low and high <= shown.end and shown.end - shown.start <= 2.0 * span + LEAST_SPAN):
        shown.update(start=low - MARGIN * span, end=high + MARGIN * span)
