"""The demo's account for people."""

from __future__ import annotations

import numpy as np

from canfb.demo.demo_network import CLOCK_DRIFT_PPM, TIMING
from canfb.demo.story import FAULTS, REFERENCE_HZ, REFERENCE_SAMPLES, Story
from canfb.signal.phase import FloatArray


def account(story: Story) -> str:
    """A short readable account, one line a fact."""
    calibration = story.calibration
    if calibration is None:
        raise ValueError("the story has not been told yet")
    before, after = np.abs(story.error_before).max(), np.abs(story.error_after).max()
    faults = story.faults
    lines = [
        "canfb demo: drive, encoder interface and feedback module on an embedded CAN bus, simulated time",
        "",
        _line("network", "started by NMT, ADC PDO linked by SDO, SYNC 1 kHz"),
        _line(
            "time",
            f"SYNC +-{TIMING.sync_jitter_us:.0f} us, and behind the frame on the wire; sample times, by a "
            f"clock {CLOCK_DRIFT_PPM:.0f} ppm off",
        ),
        _line(
            "machine",
            f"2000 rpm, {story.cycles_per_sample:.1f} encoder cycles per sample, speed wanders by 3 %",
        ),
        _line("samples", f"{story.samples}, wrong cycle counts {story.wrong_counts}"),
        _line(
            "reference",
            f"{REFERENCE_SAMPLES / REFERENCE_HZ:.1f} s at {REFERENCE_HZ // 1000} kHz, "
            f"coverage {100 * calibration.coverage:.0f} %, "
            f"table good to {100 * calibration.uncertainty_peak:.2g} % of a cycle",
        ),
        _line("table", f"{len(calibration.table)} entries by SDO, CRC-32 {story.table_crc32:08X}h, active"),
        "",
        "  position error, % of a cycle     peak       rms",
        f"    before the table           {100 * before:8.4f}  {100 * _rms(story.error_before):8.4f}",
        f"    with the table             {100 * after:8.4f}  {100 * _rms(story.error_after):8.4f}"
        "   (noise of single 12-bit samples)",
        "",
        _line("faults", ", ".join(name for name, _ in FAULTS.values())),
        _line(
            "",
            f"{faults.flagged_at_once} of {faults.provoked} flagged at once (the lost one at the next SYNC)",
        ),
        _line(
            "",
            f"wrong positions called valid {faults.wrong_and_valid}, cycles lost {faults.wrong_counts_after}",
        ),
        _line("bus load", f"{100 * story.bus_load:.0f} % of 1 Mbit/s"),
        "",
    ]
    lines += [f"  {'held  ' if held else 'FAILED'}  {name}" for name, held in story.checks.items()]
    return "\n".join(lines)


def _line(name: str, text: str) -> str:
    return f"  {name:<10} {text}"


def _rms(error: FloatArray) -> float:
    return float(np.sqrt(np.mean(error**2)))
