"""The demo's pictures; they need the extra ``canfb[plot]``."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from canfb.demo.demo_network import DemoNetwork
from canfb.demo.story import FAULTS, LOST_SAMPLE, Story
from canfb.errors import CanfbError
from canfb.signal.tracker import RESIDUAL_LIMIT

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN_SAMPLES = 4000
BEFORE, AFTER, LIMIT = "#b04a3a", "#1f6f8b", "#8a8a8a"


def prepare(folder: Path) -> None:
    """Make ``folder``. CanfbError if it cannot be made or matplotlib is missing: before the work starts."""
    try:
        importlib.import_module("matplotlib.figure")
    except ImportError:
        raise CanfbError("figures need matplotlib: pip install 'canfb[plot]'") from None
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CanfbError(f"cannot write figures to {folder}: {error.strerror}") from None


def write_figures(network: DemoNetwork, story: Story, folder: Path) -> list[Path]:
    """Write the pictures into ``folder``; their paths. CanfbError as :func:`prepare`."""
    prepare(folder)
    from matplotlib.figure import Figure

    try:
        return [
            _save(
                _tracks(Figure(figsize=(6, 6), layout="constrained"), network, story), folder / "tracks.png"
            ),
            _save(
                _error(Figure(figsize=(8, 5.5), layout="constrained"), story), folder / "error-over-phase.png"
            ),
            _save(
                _residual(Figure(figsize=(8, 4), layout="constrained"), story),
                folder / "residual-over-time.png",
            ),
        ]
    except OSError as error:
        raise CanfbError(f"cannot write figures to {folder}: {error.strerror}") from None


def _save(figure: Figure, path: Path) -> Path:
    figure.savefig(path, dpi=120)
    return path


def _axes(figure: Figure, *place: int) -> Any:
    axes = figure.add_subplot(*place)
    axes.grid(True, linewidth=0.4, alpha=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def _tracks(figure: Figure, network: DemoNetwork, story: Story) -> Figure:
    axes = _axes(figure, 1, 1, 1)
    sine, cosine = (np.array(track[-SHOWN_SAMPLES:]) for track in (network.adc.sine, network.adc.cosine))
    angle = np.linspace(0.0, 2.0 * np.pi, 400)
    radius = network.encoder.amplitude_counts
    axes.plot(radius * np.cos(angle), radius * np.sin(angle), color=LIMIT, linewidth=1, label="ideal tracks")
    axes.plot(cosine, sine, ".", markersize=1.5, color=AFTER, label="ADC samples")
    _name_faults(axes, fault_samples(network, story))
    full = 1 << (network.encoder.adc_bits - 1)
    axes.set(
        xlim=(-1.1 * full, 1.1 * full), ylim=(-1.1 * full, 1.1 * full), aspect="equal",
        title="Encoder tracks (Lissajous picture)",
        xlabel="cosine, ADC counts", ylabel="sine, ADC counts",
    )  # fmt: skip
    legend = axes.legend(loc="lower right")
    for handle in legend.legend_handles:
        if handle.get_marker() == ".":
            handle.set_markersize(9)
    return figure


def fault_samples(network: DemoNetwork, story: Story) -> list[tuple[str, int, int]]:
    """What each provoked fault made of its sample: name, sine and cosine, counts. A lost one is not there."""
    first, found, lost = story.fault_window[0], [], 0
    for place, (name, _) in sorted(FAULTS.items()):
        if place == LOST_SAMPLE:
            lost += 1
        else:
            number = first + place - lost
            found.append((name, network.adc.sine[number], network.adc.cosine[number]))
    return found


def _name_faults(axes: Any, samples: list[tuple[str, int, int]]) -> None:
    """A ring around each fault, and its name beside it: towards the middle, above and below in turn."""
    for n, (name, sine, cosine) in enumerate(samples):
        label = "provoked faults" if n == 0 else None
        axes.plot([cosine], [sine], "o", markersize=7, fillstyle="none", color=BEFORE, label=label)
        left = cosine > 0
        axes.annotate(
            name, (cosine, sine), (-9 if left else 9, -14 if n % 2 else 8), textcoords="offset points",
            ha="right" if left else "left", color=BEFORE, fontsize=8,
        )  # fmt: skip


def _error(figure: Figure, story: Story) -> Figure:
    panels = (
        (
            "before the table: Table 1 and the errors of the encoder",
            story.phase_before,
            story.error_before,
            BEFORE,
        ),
        (
            "with the correction table: noise of single 12-bit samples",
            story.phase_after,
            story.error_after,
            AFTER,
        ),
    )
    sizes = [float(np.abs(error).max()) for _, _, error, _ in panels]
    for row, (title, phase, error, colour) in enumerate(panels, start=1):
        axes = _axes(figure, 2, 1, row)
        axes.plot(phase, 100.0 * error, ".", markersize=1.5, color=colour)
        if row == 2:
            title += f"\n(scale {sizes[0] / sizes[1]:.0f} times finer than above)"
        axes.set(title=title, ylabel="error, % of a cycle", xlim=(0.0, 1.0))
    axes.set_xlabel("phase within the cycle")
    return figure


def _residual(figure: Figure, story: Story) -> Figure:
    axes = _axes(figure, 1, 1, 1)
    axes.plot(
        story.residual_number, story.residual, ".-", color=AFTER, linewidth=0.8, label="residual (eq. 12)"
    )
    axes.axhline(RESIDUAL_LIMIT, color=LIMIT, linestyle="--", linewidth=1, label="limit 1/3")
    for place, (name, _) in FAULTS.items():
        axes.axvline(place, color=BEFORE, linewidth=0.8)
        axes.text(place + 0.5, 0.52, name, color=BEFORE, fontsize=8)
    axes.set(
        title="Residual while faults are provoked at 2000 rpm",
        xlabel="sample",
        ylabel="residual, cycles",
        ylim=(0, 0.56),
    )
    axes.legend(loc="center right")
    return figure
