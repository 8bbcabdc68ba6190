"""The demo's account, for people and for programs."""

from __future__ import annotations

from typing import Any

from canfb.demo.demo_network import CLOCK_DRIFT_PPM, TIMING
from canfb.demo.servo_act import ACCELERATION_RAD_S2, JERK_RAD_S3, RPM
from canfb.demo.story import FAULTS, REFERENCE_HZ, REFERENCE_SAMPLES, Story, peak, rms
from canfb.rows import Row, as_figures, as_lines

TITLE = "canfb demo: drive, encoder interface and feedback module on an embedded CAN bus, simulated time"
WIDTH = 11  # of the names, characters


def account(story: Story) -> str:
    """A short readable account, one line a fact. ValueError if the demo has not run yet."""
    before, after = story.error_before, story.error_after
    lines = [
        TITLE,
        "",
        *_indented(run_facts(story)),
        "",
        "  position error, % of a cycle     peak       rms",
        f"    before the table           {100 * peak(before):8.4f}  {100 * rms(before):8.4f}",
        f"    with the table             {100 * peak(after):8.4f}  {100 * rms(after):8.4f}"
        "   (noise of single 12-bit samples)",
        "",
        *_indented(fault_facts(story)),
        "",
        *_indented(servo_facts(story)),
        "",
    ]
    lines += [f"  {verdict(held):6}  {name}" for name, held in story.checks.items()]
    return "\n".join(lines)


def _indented(facts: list[Row]) -> list[str]:
    return [f"  {line}" for line in as_lines(facts, WIDTH)]


def figures(story: Story) -> dict[str, Any]:
    """The same for programs. ValueError as :func:`account`."""
    errors = Row(
        held=story.held,
        checks=story.checks,
        error_peak_before_cycles=peak(story.error_before),
        error_peak_after_cycles=peak(story.error_after),
        error_rms_before_cycles=rms(story.error_before),
        error_rms_after_cycles=rms(story.error_after),
    )
    return as_figures([errors], run_facts(story), fault_facts(story), servo_facts(story))


def run_facts(story: Story) -> list[Row]:
    """How it was run, and what came of it. ValueError as :func:`account`."""
    calibration = story.calibration
    if calibration is None:
        raise ValueError("the demo has not run yet")
    return [
        Row("network", "started by NMT, ADC PDO linked by SDO, SYNC 1 kHz"),
        Row(
            "time",
            f"SYNC +-{TIMING.sync_jitter_us:.0f} us, and behind the frame on the wire; sample times from a "
            f"clock {CLOCK_DRIFT_PPM:.0f} ppm off",
            sync_jitter_us=TIMING.sync_jitter_us,
            clock_drift_ppm=CLOCK_DRIFT_PPM,
        ),
        Row(
            "machine",
            f"2000 rpm, {story.cycles_per_sample:.1f} encoder cycles per sample, speed varies by 3 %",
            cycles_per_sample=story.cycles_per_sample,
        ),
        Row(
            "samples",
            f"{story.samples}, wrong cycle counts {story.wrong_counts}",
            samples=story.samples,
            wrong_cycle_counts=story.wrong_counts,
        ),
        Row(
            "reference",
            f"{REFERENCE_SAMPLES / REFERENCE_HZ:.1f} s at {REFERENCE_HZ // 1000} kHz, "
            f"coverage {100 * calibration.coverage:.0f} %, "
            f"table good to {100 * calibration.uncertainty_peak:.2g} % of a cycle",
            table_uncertainty_peak_cycles=calibration.uncertainty_peak,
        ),
        Row(
            "table",
            f"{len(calibration.table)} entries by SDO, CRC-32 {story.table_crc32:08X}h, active",
            table_crc32=f"{story.table_crc32:08X}",
        ),
    ]


def fault_facts(story: Story) -> list[Row]:
    """The provoked faults and the bus."""
    faults = story.faults
    return [
        Row("faults", ", ".join(name for name, _ in FAULTS.values())),
        Row(
            "",
            f"{faults.flagged_at_once} of {faults.provoked} flagged at once (the lost one at the next SYNC)",
            faults_provoked=faults.provoked,
            faults_flagged_in_the_same_sample=faults.flagged_at_once,
        ),
        Row(
            "",
            f"wrong positions published as valid {faults.wrong_and_valid}, "
            f"cycles lost {faults.wrong_counts_after}",
            wrong_positions_called_valid=faults.wrong_and_valid,
        ),
        Row("bus load", f"{100 * story.bus_load:.0f} % of 1 Mbit/s", bus_load=story.bus_load),
    ]


def servo_facts(story: Story) -> list[Row]:
    """The second act, and what other settings make of it."""
    move = f"0 to {RPM:g} rpm in 50 ms: {ACCELERATION_RAD_S2:g} rad/s^2, {JERK_RAD_S3:g} rad/s^3"
    return [
        Row("servo", move, servo_move={run.name: run.figures() for run in story.servo}),
        *(Row("", f"{run.name}: {run.outcome}") for run in story.servo),
    ]


def verdict(held: bool) -> str:
    """Result of a check, in words."""
    return "held" if held else "FAILED"
