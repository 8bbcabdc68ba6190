"""The pictures of the paper's reproduction; they need the extra `canfb[tools]`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from canfb import CorrectionTable, phase_in_cycle
from canfb.simulation.encoder import Encoder
from tools.paper.conventional import extremes, ours_wrong, shares, shift_cycles
from tools.paper.detection import accelerated, is_silent, onset
from tools.paper.phase import PAPER_TABLE_ENTRIES, phases_as_printed
from tools.paper.plant import (
    CYCLES_PER_REVOLUTION,
    EXTREME,
    IDEAL,
    USUAL,
    FloatArray,
    exact_table,
    phase_error,
)
from tools.paper.tracking import sample_picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BEFORE, AFTER, LIMIT = "#b04a3a", "#1f6f8b", "#8a8a8a"
ZONE_EDGES = (0.0, 1 / 3, 1 / 2, 2 / 3, 1.3)
ZONE_COLOURS = ("#e4f0e4", "#fbf3d9", "#f6dcd6", "#dcd6e8")
ZONES = {
    1 / 6: "right",
    5 / 12: "right,\nflagged",
    7 / 12: "wrong,\nflagged",
    0.98: "wrong, no flag while it lasts",
}


def can_draw() -> bool:
    """Matplotlib is there."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError:
        return False
    return True


def write_figures(folder: Path, onsets: int = 150) -> list[Path]:
    """Write the pictures into `folder`, made if need be; their paths. `onsets` tried for each point."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, figure in _figures(onsets):
        path = folder / f"{name}.png"
        figure.savefig(path, dpi=120)
        written.append(path)
    return written


def _figures(onsets: int) -> Iterator[tuple[str, Figure]]:
    yield "error-over-phase", _error_over_phase(_figure(8, 9))
    yield "83-cycles-per-sample", _far_apart(_figure(8, 9))
    yield "acceleration-limits", _acceleration(_figure(8, 8), onsets)
    yield "conventional-method", _conventional(_figure(8, 5.5))


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _axes(figure: Figure, rows: int, row: int) -> Any:
    axes = figure.add_subplot(rows, 1, row)
    axes.grid(True, linewidth=0.4, alpha=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def _error_over_phase(figure: Figure) -> Figure:
    position = np.arange(4000) / 4000
    raw = phase_in_cycle(*IDEAL.tracks(position))
    axes = _axes(figure, 3, 1)
    printed = phases_as_printed(position)
    axes.plot(position, printed, "--", color=BEFORE, label="last column as printed: 1 + s/c")
    axes.plot(position, raw, color=AFTER, label="with 1 + s/(8c)")
    axes.set(title="Table 1 on ideal tracks", ylabel="raw phase, cycles", xlim=(0, 1), ylim=(-0.03, 1.03))
    axes.legend(loc="upper left")
    axes = _axes(figure, 3, 2)
    axes.plot(position, 100.0 * (raw - position), color=BEFORE)
    axes.set(title="Its error, ideal tracks", ylabel="error, % of a cycle", xlim=(0, 1))
    axes = _axes(figure, 3, 3)
    identity = CorrectionTable.identity()
    for table, colour, style, label in (
        (identity, LIMIT, "-", "Table 1 alone"),
        (exact_table(IDEAL, PAPER_TABLE_ENTRIES), BEFORE, "-", "arc-tangent correction"),
        (exact_table(EXTREME, PAPER_TABLE_ENTRIES), AFTER, "-", "individual table, 200 entries"),
    ):
        error = _corrected_error(EXTREME, table, position)
        axes.plot(
            position, 100.0 * error, style, color=colour, label=f"{label}: {100 * np.abs(error).max():.2g} %"
        )
    axes.set(
        title="Error with 40 % offset and 20 % amplitude error",
        xlabel="position within the cycle",
        ylabel="error, % of a cycle",
        xlim=(0, 1),
    )
    axes.legend(loc="lower right", title="largest error", fontsize=8)
    return figure


def _corrected_error(encoder: Encoder, table: CorrectionTable, position: FloatArray) -> FloatArray:
    return phase_error(table(phase_in_cycle(*encoder.tracks(position))), position)


def _far_apart(figure: Figure) -> Figure:
    way, sine, result = sample_picture(2500)
    time = np.arange(len(way)) / 1000.0
    error = way.error(result.cycles, result.phase)
    _between_two_samples(_axes(figure, 4, 1))
    axes = _axes(figure, 4, 2)
    axes.plot(time, sine, ".", markersize=2, color=BEFORE)
    axes.set(
        title="What the converter sees at 1 kHz: a reversal from +2000 to −2000 rpm",
        ylabel="ADC counts",
    )
    axes = _axes(figure, 4, 3)
    turns = (result.cycles + result.phase) / CYCLES_PER_REVOLUTION
    axes.plot(time, turns, color=AFTER)
    axes.set(title="What comes out", ylabel="position, revolutions")
    axes = _axes(figure, 4, 4)
    axes.plot(time, 100.0 * error, ".", markersize=2, color=AFTER)
    axes.set(
        title="Error of the position: noise and steps of a 12-bit converter",
        ylabel="error, % of a cycle",
        xlabel="time, s",
    )
    return figure


def _between_two_samples(axes: Any) -> None:
    cycles = np.linspace(0.0, 83.33, 8000)
    axes.plot(cycles / 83.33, USUAL.tracks(cycles)[0], color=LIMIT, linewidth=0.7)
    ends = np.array([0.0, 83.33])
    axes.plot([0, 1], USUAL.tracks(ends)[0], "o", color=BEFORE)
    axes.set(
        title="The sine track between two samples (dots) at 2000 rpm",
        xlabel="time, ms",
        ylabel="ADC counts",
        xlim=(-0.01, 1.01),
    )


def _acceleration(figure: Figure, onsets: int) -> Figure:
    change = np.linspace(0.01, 1.3, 130)
    runs = [accelerated(a) for a in change]
    axes = _axes(figure, 3, 1)
    _zones(axes)
    axes.plot(change, [run.steady_residual for run in runs], color=AFTER)
    axes.axhline(1 / 3, color=LIMIT, linestyle="--", linewidth=1)
    axes.text(0.01, 1 / 3 + 0.012, "limit 1/3", color=LIMIT, fontsize=8)
    axes.set(title="Residual while the acceleration lasts", ylabel="residual, cycles", ylim=(0, 0.62))
    for place, text in ZONES.items():
        axes.text(place, 0.57, text, ha="center", va="center", fontsize=8)
    axes = _axes(figure, 3, 2)
    _zones(axes)
    axes.plot(change, [run.end_speed_error for run in runs], color=BEFORE)
    axes.set(title="Error of the speed after 60 samples of acceleration", ylabel="cycles per sample")
    axes = _axes(figure, 3, 3)
    _zones(axes)
    fraction = (np.arange(onsets) + 0.5) / onsets
    for rise, colour, label in (
        (0.0, BEFORE, "sudden onset"),
        (1 / 0.3, AFTER, "rising by at most 0.3 cycle in a sample"),
    ):
        part = [np.mean([is_silent(onset(a, f, rise * a)) for f in fraction]) for a in change]
        axes.plot(change, 100.0 * np.array(part), color=colour, label=label)
    axes.set(
        title="Positions that become wrong without a flag up to then",
        ylabel="% of onsets",
        xlabel="acceleration, cycles per sampling interval squared (eq. 10: 0.5)",
    )
    axes.legend(loc="upper left")
    return figure


def _zones(axes: Any) -> None:
    for start, stop, colour in zip(ZONE_EDGES[:-1], ZONE_EDGES[1:], ZONE_COLOURS, strict=True):
        axes.axvspan(start, stop, color=colour, linewidth=0)
    axes.set_xlim(ZONE_EDGES[0], ZONE_EDGES[-1])


def _conventional(figure: Figure) -> Figure:
    shifts = np.linspace(0.0, 0.5, 101)
    axes = _axes(figure, 1, 1)
    narrow = max(extremes(), key=lambda encoder: shares(encoder, np.array([0.2]), True)[0])
    for encoder, fix, style, colour, label in (
        (IDEAL, False, "-", BEFORE, "counter and converters, no fix"),
        (IDEAL, True, "-", LIMIT, "with the fix, ideal tracks"),
        (narrow, True, "--", LIMIT, "with the fix, 40 % offset and 20 % amplitude error"),
    ):
        axes.plot(shifts, 100.0 * shares(encoder, shifts, fix), style, color=colour, label=label)
    ours = np.full(len(shifts), 100.0 * ours_wrong(20_000) / 20_000)
    axes.plot(shifts, ours, color=AFTER, linewidth=2.5, label="this method: one instant, no counter")
    axes.set(
        title="Positions in a wrong cycle\n",
        ylabel="% of the samples",
        xlabel="way between reading the counter and the converters, cycles",
        xlim=(0, 0.5),
    )
    axes.legend(loc="upper left")
    per_us = shift_cycles(2000.0, 1e-6)
    above = axes.secondary_xaxis("top", functions=(lambda x: x / per_us, lambda t: t * per_us))
    above.set_xlabel("offset in time at 2000 rpm, µs")
    return figure
