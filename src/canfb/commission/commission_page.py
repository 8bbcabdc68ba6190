"""The report of ``canfb commission``: one HTML file that stands alone."""

from __future__ import annotations

from pathlib import Path

from canfb import objects as od
from canfb.calibrate.artefacts import REPORT
from canfb.calibrate.calibration_page import place_line
from canfb.commission.commission_summary import (
    SUM_WORDS,
    Commissioned,
    detection_rows,
    detection_words,
    kept_words,
    limit_rows,
    machine_facts,
    notes,
    outcome,
)
from canfb.commission.machine_figures import smooth_acceleration
from canfb.master.all_or_nothing import write_whole
from canfb.master.machine_watch import origins
from canfb.report import pictures
from canfb.report.page import figure, gallery, page, table
from canfb.report.pictures import lissajous

FOOTER = (
    "Made by canfb commission. L is the residual limit in force, a the largest acceleration, in "
    "cycles and sampling intervals. The limits hold for the motion that was seen, times the margin."
)


def write_page(folder: Path, done: Commissioned) -> Path:
    """Write the page into a folder; its path. CommissioningError if that does not work."""
    path = folder / REPORT
    write_whole(path, commission_html(done).encode())
    return path


def commission_html(done: Commissioned) -> str:
    """The page. It refers to nothing outside of itself and runs no script."""
    said = [
        f"{detection_words(done)}.",
        f"{kept_words(done)}.",
        f"{outcome(done)[:1].upper()}{outcome(done)[1:]}.",
        *notes(done),
    ]
    body = (
        table("Limits", limit_rows(done), ("before", "proposed", "why"), style="listed")
        + table("The machine", machine_facts(done))
        + table(
            "Bad samples in a row that cannot falsify the cycle count unseen",
            detection_rows(done),
            (f"{SUM_WORDS}, cycle", "before", "proposed"),
        )
        + gallery("Pictures", _pictures(done))
        + table("Origin", origins(done.where), style="origin")
    )
    return page("Limits of the supervision", place_line(done.where), said, body, FOOTER)


def _pictures(done: Commissioned) -> list[str]:
    machine, interval_s = done.machine, done.machine.interval_s
    old, new = (limits.residual_limit(interval_s) for limits in (done.before, done.new))
    low, high = (
        done.new.values[place] for place in (od.ENCODER_LOWEST_AMPLITUDE, od.ENCODER_HIGHEST_AMPLITUDE)
    )
    largest = done.new.acceleration_cycles(interval_s)
    samples, noise = done.observed.samples, machine.motion.noise
    to_rad = machine.rad(1.0, 2, done.new.cycles_per_revolution)
    listed = [
        (
            "Residual",
            "of each sample, eq. 12, with the residual limit in force",
            pictures.residual_histogram(machine.motion.residual, old, new),
        ),
        (
            "Amplitude over the phase",
            "lowest, mean and highest of the samples in each 1/64 cycle, with its limits",
            pictures.amplitude_over_phase(machine.tracks.over_phase, low, high),
        ),
        (
            "Acceleration over time",
            "averaged as far as the noise demands, with the limit 2010:02",
            pictures.acceleration_over_time(
                to_rad * smooth_acceleration(machine.motion.residual, noise), interval_s, to_rad * largest
            ),
        ),
        (
            "Lissajous figure",
            "all samples within the new limits of the amplitude",
            lissajous(
                samples.sine,
                samples.cosine,
                done.observed.used.conditioning,
                done.new.chain_limits(interval_s).sample,
            ),
        ),
    ]
    return [figure(name, text, svg) for name, text, svg in listed]
