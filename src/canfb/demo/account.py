"""The demo's account for people."""

from __future__ import annotations

from canfb.demo.demo_network import CLOCK_DRIFT_PPM, TIMING
from canfb.demo.servo_act import ACCELERATION_RAD_S2, JERK_RAD_S3, RPM
from canfb.demo.story import FAULTS, REFERENCE_HZ, REFERENCE_SAMPLES, Story, peak, rms

TITLE = "canfb demo: drive, encoder interface and feedback module on an embedded CAN bus, simulated time"


def account(story: Story) -> str:
    """A short readable account, one line a fact. ValueError if the demo has not run yet."""
    before, after = story.error_before, story.error_after
    lines = [
        TITLE,
        "",
        *(_line(*fact) for fact in run_facts(story)),
        "",
        "  position error, % of a cycle     peak       rms",
        f"    before the table           {100 * peak(before):8.4f}  {100 * rms(before):8.4f}",
        f"    with the table             {100 * peak(after):8.4f}  {100 * rms(after):8.4f}"
        "   (noise of single 12-bit samples)",
        "",
        *(_line(*fact) for fact in fault_facts(story)),
        "",
        *(_line(*fact) for fact in servo_facts(story)),
        "",
    ]
    lines += [f"  {verdict(held):6}  {name}" for name, held in story.checks.items()]
    return "\n".join(lines)


def run_facts(story: Story) -> list[tuple[str, str]]:
    """Names and words: how it was run, and what came of it. ValueError as :func:`account`."""
    calibration = story.calibration
    if calibration is None:
        raise ValueError("the demo has not run yet")
    return [
        ("network", "started by NMT, ADC PDO linked by SDO, SYNC 1 kHz"),
        (
            "time",
            f"SYNC +-{TIMING.sync_jitter_us:.0f} us, and behind the frame on the wire; sample times from a "
            f"clock {CLOCK_DRIFT_PPM:.0f} ppm off",
        ),
        (
            "machine",
            f"2000 rpm, {story.cycles_per_sample:.1f} encoder cycles per sample, speed varies by 3 %",
        ),
        ("samples", f"{story.samples}, wrong cycle counts {story.wrong_counts}"),
        (
            "reference",
            f"{REFERENCE_SAMPLES / REFERENCE_HZ:.1f} s at {REFERENCE_HZ // 1000} kHz, "
            f"coverage {100 * calibration.coverage:.0f} %, "
            f"table good to {100 * calibration.uncertainty_peak:.2g} % of a cycle",
        ),
        ("table", f"{len(calibration.table)} entries by SDO, CRC-32 {story.table_crc32:08X}h, active"),
    ]


def fault_facts(story: Story) -> list[tuple[str, str]]:
    """The same of the provoked faults and of the bus; a fact without a name goes on from the one before."""
    faults = story.faults
    return [
        ("faults", ", ".join(name for name, _ in FAULTS.values())),
        (
            "",
            f"{faults.flagged_at_once} of {faults.provoked} flagged at once (the lost one at the next SYNC)",
        ),
        (
            "",
            f"wrong positions published as valid {faults.wrong_and_valid}, "
            f"cycles lost {faults.wrong_counts_after}",
        ),
        ("bus load", f"{100 * story.bus_load:.0f} % of 1 Mbit/s"),
    ]


def servo_facts(story: Story) -> list[tuple[str, str]]:
    """The same of the second act, and of what other settings make of it."""
    move = f"0 to {RPM:g} rpm in 50 ms: {ACCELERATION_RAD_S2:g} rad/s^2, {JERK_RAD_S3:g} rad/s^3"
    return [("servo", move), *(("", f"{run.name}: {run.outcome}") for run in story.servo)]


def verdict(held: bool) -> str:
    """Result of a check, in words."""
    return "held" if held else "FAILED"


def _line(name: str, text: str) -> str:
    return f"  {name:<10} {text}"
