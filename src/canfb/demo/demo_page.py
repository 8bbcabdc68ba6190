"""The results of the demo as text and JSON; its pictures and page, and its files in a folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from canfb.calibration.result import peak, root_mean
from canfb.demo.story import (
    ACCELERATION_RAD_S2,
    CLOCK_DRIFT_PPM,
    FAULT_SAMPLES,
    FAULTS,
    JERK_RAD_S3,
    LOST_SAMPLE,
    REFERENCE_HZ,
    REFERENCE_SAMPLES,
    RPM,
    TIMING,
    DemoNetwork,
    ServoRun,
    Story,
)
from canfb.files import REPORT, writing
from canfb.report.page import beside, figure, gallery, page, svg_file, table
from canfb.report.pictures import PERCENT, SHOWN_SAMPLES, circle, cloud, square_plot
from canfb.report.plot import Plot, nice_limit
from canfb.rows import Row, as_columns, as_figures, as_lines
from canfb.signal.phase import FloatArray
from canfb.signal.tracker import RESIDUAL_LIMIT

TITLE = "canfb demo: drive, encoder interface and feedback module on an embedded CAN bus, simulated time"
WIDTH = 11  # of the names, characters
ERROR_HEADS = "position error, % of a cycle", "before the table", "with the table"


def account(story: Story) -> str:
    """The results as text, one line per fact. ValueError before the demo has run."""
    return "\n".join(
        [
            TITLE,
            "",
            *_indented(run_facts(story)),
            "",
            *(f"  {line}" for line in as_columns(error_facts(story), ERROR_HEADS)),
            "",
            *_indented(fault_facts(story)),
            "",
            *_indented(servo_facts(story)),
            "",
            *(f"  {verdict(held):6}  {name}" for name, held in story.checks.items()),
        ]
    )


def _indented(facts: list[Row]) -> list[str]:
    return [f"  {line}" for line in as_lines(facts, WIDTH)]


def error_facts(story: Story) -> list[Row]:
    errors = story.error_before, story.error_after
    return [
        Row(name, *(f"{100.0 * size(error):.4f}" for error in errors))
        for name, size in (("peak", peak), ("rms", root_mean))
    ]


def figures(story: Story) -> dict[str, Any]:
    """The results for JSON. ValueError as :func:`account`."""
    errors = Row(
        held=story.held,
        checks=story.checks,
        error_peak_before_cycles=peak(story.error_before),
        error_peak_after_cycles=peak(story.error_after),
        error_rms_before_cycles=root_mean(story.error_before),
        error_rms_after_cycles=root_mean(story.error_after),
    )
    return as_figures([errors], run_facts(story), fault_facts(story), servo_facts(story))


def run_facts(story: Story) -> list[Row]:
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
    return [
        Row("faults", ", ".join(name for name, _ in FAULTS.values())),
        Row(
            "",
            f"{story.flagged_at_once} of {len(FAULTS)} flagged at once (the lost one at the next SYNC)",
            faults_provoked=len(FAULTS),
            faults_flagged_in_the_same_sample=story.flagged_at_once,
        ),
        Row(
            "",
            f"wrong positions published as valid {story.wrong_and_valid}, "
            f"cycles lost {story.wrong_counts_after}",
            wrong_positions_called_valid=story.wrong_and_valid,
        ),
        Row("bus load", f"{100 * story.bus_load:.0f} % of 1 Mbit/s", bus_load=story.bus_load),
    ]


def servo_facts(story: Story) -> list[Row]:
    """Results of the servo move, also with other settings."""
    move = f"0 to {RPM:g} rpm in 50 ms: {ACCELERATION_RAD_S2:g} rad/s^2, {JERK_RAD_S3:g} rad/s^3"
    return [
        Row("servo", move, servo_move={run.name: run.figures() for run in story.servo}),
        *(Row("", f"{run.name}: {run.outcome}") for run in story.servo),
    ]


def verdict(held: bool) -> str:
    return "held" if held else "FAILED"


MOVE_SHOWN_MS = -10.0, 75.0
FIRST_NAME, NAMES_APART = 0.75, 0.06  # height of the first name of a fault, above all residuals; distance


def tracks(network: DemoNetwork, story: Story) -> Plot:
    recorded = np.transpose(network.recorder.tracks())
    shown = recorded[np.isfinite(recorded[:, 0])][-SHOWN_SAMPLES:]
    plot = square_plot(
        "Lissajous figure: sine over cosine, with the provoked faults",
        1.1 * (1 << network.encoder.adc_bits - 1),
    )
    circle(plot, network.encoder.amplitude_counts, "limit", "ideal tracks")
    cloud(plot, shown[:, 1], shown[:, 0], "after", "ADC samples")
    faults = {place: name for place, (name, _) in FAULTS.items() if place != LOST_SAMPLE}
    at = recorded[story.fault_window[0] + np.array(list(faults))]
    plot.dots(at[:, 1], at[:, 0], "after large")
    plot.rings(at[:, 1], at[:, 0], "before", "provoked faults")
    for number, (name, (sine, cosine)) in enumerate(zip(faults.values(), at.tolist(), strict=True)):
        # Place the text towards the middle, alternately above and below.
        left, down = cosine > 0, 20.0 if number % 2 else -9.0
        plot.note(cosine, sine, name, "before end" if left else "before", (-9.0 if left else 9.0, down))
    return plot


def position_error(phase: FloatArray, error: FloatArray, style: str, which: str) -> Plot:
    most = PERCENT * nice_limit(error)
    plot = Plot(
        f"Position error over the phase, {which}",
        (0.0, 1.0),
        (-most, most),
        ("phase, cycles", "error, % of a cycle"),
    )
    return plot.dots(phase, PERCENT * error, style)


def residual(story: Story) -> Plot:
    plot = Plot(
        "Residual while faults are provoked at 2000 rpm",
        (0.0, float(FAULT_SAMPLES)),
        (0.0, FIRST_NAME + NAMES_APART),
        ("sample", "residual, cycles"),
    )
    for row, (place, (name, _)) in enumerate(sorted(FAULTS.items())):
        # Each name is below the previous one, so that no line crosses a name.
        height = FIRST_NAME - NAMES_APART * row
        plot.line(np.array([place, place], np.float64), np.array([0.0, height]), "before thin")
        plot.note(place, height, name, "before", (5.0, 6.0))
    number = story.residual_number.astype(np.float64)
    plot.line(number, story.residual, "after thin", "residual (eq. 12)")
    plot.dots(number, story.residual, "after large")
    return plot.level(RESIDUAL_LIMIT, "limit 1/3")


def servo(story: Story) -> Plot:
    """Residuals of the servo's move with four samples for each SYNC, and with one."""
    plot = Plot(
        "Residual of each sample in a move of a servo from 0 to 3000 rpm in 50 ms",
        MOVE_SHOWN_MS,
        (0.0, 0.55),
        ("time, ms", "residual, cycles"),
    )
    if not story.servo:
        return plot
    ours, eq_9 = story.servo[0], story.servo[-1]
    plot.line(*_shown(eq_9), "before thin", eq_9.name)
    plot.line(*_shown(ours), "after thin", ours.name)
    plot.dots(*_shown(ours), "after")
    return plot.level(ours.limit_cycles, f"limit {ours.limit_cycles:.2f}")


def _shown(run: ServoRun) -> tuple[FloatArray, FloatArray]:
    time_ms = 1e3 * run.time_s
    inside = (time_ms >= MOVE_SHOWN_MS[0]) & (time_ms <= MOVE_SHOWN_MS[1])
    return time_ms[inside], run.residual[inside]


FOOTER = "Made by canfb demo: a simulation with fixed seeds; its figures are the same each time."
RESIDUAL = "Residual while faults are provoked"
SERVO = "A move of a servo"
TRACKS = "Encoder tracks"
BEFORE, AFTER = "Position error before the table", "Position error with the table"


def write_files(
    network: DemoNetwork, story: Story, folder: Path, version: str, date: str
) -> tuple[list[Path], Path]:
    """Write the pictures and the page into ``folder``; their paths. CanfbError.

    ``version`` of canfb and ``date`` are for the page: the same arguments give the same bytes.
    """
    shown, before, after, faults, moved = pictures = (
        tracks(network, story),
        position_error(story.phase_before, story.error_before, "before", "without a table"),
        position_error(story.phase_after, story.error_after, "after", "with the table"),
        residual(story),
        servo(story),
    )
    files = {
        "tracks.svg": svg_file([(TRACKS, shown)]),
        "error-over-phase.svg": svg_file([(BEFORE, before), (AFTER, after)]),
        "residual-over-time.svg": svg_file([(RESIDUAL, faults)]),
        "servo-move.svg": svg_file([(SERVO, moved)]),
        REPORT: demo_page(story, f"canfb {version}, {date}", pictures),
    }
    with writing(folder):
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")
    *drawings, report = (folder / name for name in files)
    return drawings, report


def demo_page(story: Story, made: str, pictures: tuple[Plot, Plot, Plot, Plot, Plot]) -> str:
    """The page: text and pictures. ValueError before the demo has run.

    made        version and date
    pictures    tracks, error before and after the table, residual, the move of the servo
    """
    shown, before, after, faults, moved = pictures
    tables = table("Position error, % of a cycle", error_facts(story), ERROR_HEADS[1:])
    tables += table("Run", [*run_facts(story), *fault_facts(story)])
    act = table("A move of a servo", servo_facts(story))
    checks = table("Checks", [Row(name, verdict(held)) for name, held in story.checks.items()])
    finer = peak(story.error_before) / peak(story.error_after)
    return page(
        "canfb demo",
        f"{TITLE.partition(': ')[2]}; {made}",
        _said(story),
        beside(tables, figure(TRACKS, "the last samples; ideal tracks are a circle", shown.svg()))
        + gallery(
            "Error over the phase",
            [
                figure(BEFORE, "Table 1 and the errors of the encoder", before.svg()),
                figure(AFTER, f"noise of single 12-bit samples, scale {finer:.0f} times finer", after.svg()),
            ],
        )
        + beside(checks, figure(RESIDUAL, "at 2000 rpm; the limit is that of eq. 12", faults.svg()))
        + beside(act, figure(SERVO, "all samples; four samples for each SYNC", moved.svg())),
        FOOTER,
        story.held,
    )


def _said(story: Story) -> list[str]:
    failed = [name for name, held in story.checks.items() if not held]
    if failed:
        return [f"Failed: {', '.join(failed)}."]
    before, after = 100 * root_mean(story.error_before), 100 * root_mean(story.error_after)
    return [
        f"All checks passed. The position error falls from {before:.2g} % to {after:.2g} % of a cycle rms.",
        f"{story.samples} samples at {story.cycles_per_sample:.1f} cycles per sample, no wrong cycle count.",
    ]
