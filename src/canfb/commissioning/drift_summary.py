"""The figures of a drift check: for the terminal and for programs."""

from __future__ import annotations

from typing import Any

from canfb.commissioning.circumstances import PERCENT, Circumstances, percent, where_words
from canfb.commissioning.drift_check import DriftCheck
from canfb.commissioning.own_calibration import ModuleDrift
from canfb.commissioning.summary import table_words
from canfb.signal.correction import Correction


def module_drift_lines(found: ModuleDrift, active: Correction, where: Circumstances) -> list[str]:
    """The check by the module itself, as text."""
    return [
        f"{'active table':24}{table_words(active)}",
        f"{'its error now, rms':24}{percent(found.rms, where)} of a cycle",
        f"{'its error now, peak':24}{percent(found.peak, where)} of a cycle",
        f"{'noise of a sample':24}{percent(found.residual_rms, where)} rms",
        f"{'coverage':24}{100 * found.coverage:.0f} %",
    ]


def module_drift_json(found: ModuleDrift, active: Correction, where: Circumstances) -> dict[str, Any]:
    """The same for programs; cycles."""
    return {
        **where_words(where),
        "crc32": f"{active.crc32:08X}",
        "drift_rms_cycles": found.rms,
        "drift_peak_cycles": found.peak,
        "new_table_rms_cycles": found.residual_rms,
        "coverage": found.coverage,
    }


def drift_lines(found: DriftCheck, where: Circumstances) -> list[str]:
    """For people."""
    lines = [
        f"{'active table':24}{table_words(found.active)}",
        f"{'its error now, rms':24}{percent(found.rms, where)} of a cycle",
        f"{'its error now, peak':24}{percent(found.peak, where)} of a cycle",
        f"{'uncertainty, peak':24}{percent(found.calibration.uncertainty_peak, where)} of a cycle",
        f"{'deviation of samples':24}{percent(found.on_samples.before_rms, where)} rms now, "
        f"{percent(found.calibration.residual_rms, where)} with a new table",
    ]
    if found.change is not None:
        change, part = found.change, PERCENT
        lines.append(
            f"{'changed since':24}offset {part * change.sine_offset:+.2g} / "
            f"{part * change.cosine_offset:+.2g} % of the amplitude, gain of the cosine "
            f"{part * change.gain:+.2g} %, phase {change.phase_rad:+.2g} rad"
        )
    if not found.seen:
        lines.append("no drift within the uncertainty of this measurement")
    return lines


def drift_json(found: DriftCheck, where: Circumstances) -> dict[str, Any]:
    """For programs; cycles."""
    return {
        **where_words(where),
        "crc32": f"{found.active.crc32:08X}",
        "drift_rms_cycles": found.rms,
        "drift_peak_cycles": found.peak,
        "drift_seen": found.seen,
        "uncertainty_rms_cycles": found.calibration.uncertainty_rms,
        "uncertainty_peak_cycles": found.calibration.uncertainty_peak,
        "active_rms_cycles": found.on_samples.before_rms,
        "new_table_rms_cycles": found.calibration.residual_rms,
        "coverage": found.calibration.coverage,
        "samples": found.calibration.samples_used,
        "changed": None if found.change is None else found.change._asdict(),
    }
