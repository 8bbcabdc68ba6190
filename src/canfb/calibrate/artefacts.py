"""Files of a reference measurement in a folder: table, samples, report."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from canfb.calibrate.calibration_summary import coverage_warning, findings
from canfb.calibrate.measurement import Measurement, SpeedSamples
from canfb.calibrate.procedure import Installation
from canfb.calibration.result import BINS, samples_in_bins
from canfb.errors import CalibrationError
from canfb.files import REPORT, writing
from canfb.master.machine_watch import Provenance, origins
from canfb.master.samples import TrackSamples, write_npz
from canfb.report import pictures
from canfb.report.page import beside, figure, gallery, page, section, table
from canfb.rows import Row
from canfb.sdo.tables import as_yaml
from canfb.signal.correction import NO_CORRECTION, Correction
from canfb.signal.supervision import SampleLimits

TABLE_YAML, TABLE_BIN, SAMPLES = "table.yaml", "table.bin", "samples.npz"
SPEEDS = "speeds"
# Keys of the YAML besides crc32, conditioning and entries.
META = (
    "date",
    "time",
    "canfb",
    "encoder",
    "module",
    "module_identity",
    "encoder_interface",
    "encoder_interface_identity",
    "cycles_per_revolution",
    "method",
    "verdict",
    "samples",
    "sample_rate_hz",
    "coverage",
    "before_rms_cycles",
    "residual_rms_cycles",
    "residual_peak_cycles",
    "uncertainty_peak_cycles",
    "corner_hz",
    "cosine_corner_hz",
    "delay_estimate_s",
    "active",
    "saved",
)


def write(
    folder: Path,
    measured: Measurement,
    done: Installation,
    where: Provenance,
    limits: SampleLimits | None = None,
) -> list[Path]:
    figures = findings(measured, done, where).to_json()
    meta = {key: figures[key] for key in META if figures.get(key) is not None}
    with writing(folder):
        (folder / TABLE_YAML).write_text(as_yaml(measured.found, meta), encoding="utf-8")
        (folder / TABLE_BIN).write_bytes(measured.calibration.table.to_bytes())
        write_npz(folder / SAMPLES, measured.samples)
        (folder / REPORT).write_text(report_html(measured, done, where, limits), encoding="utf-8")
    return [folder / name for name in (TABLE_YAML, TABLE_BIN, SAMPLES, REPORT)]


def keep_samples(folder: Path, samples: TrackSamples) -> Path:
    with writing(folder):
        write_npz(folder / SAMPLES, samples)
    return folder / SAMPLES


def keep_speeds(folder: Path, measured: Iterable[SpeedSamples]) -> None:
    place = folder / SPEEDS
    with writing(place):
        place.mkdir(exist_ok=True)
        for old in place.glob("*.npz"):  # left by an earlier run
            old.unlink()
        for number, one in enumerate(measured, 1):
            write_npz(place / f"{number:02d}.npz", one.samples, one.hertz)


def write_refusal(
    folder: Path,
    samples: TrackSamples,
    refused: CalibrationError,
    where: Provenance,
    limits: SampleLimits | None = None,
) -> None:
    """Samples and report of a refused measurement, without a table: they show the reason."""
    with writing(folder):
        for name in (TABLE_YAML, TABLE_BIN):  # files of an earlier run must not pass for results of this one
            (folder / name).unlink(missing_ok=True)
        write_npz(folder / SAMPLES, samples)
        (folder / REPORT).write_text(refusal_html(samples, refused, where, limits), encoding="utf-8")


FOOTER = (
    "Made by canfb calibrate. Deviation: difference of single samples from smooth motion, noise included. "
    "No table is judged by the samples from which it was calculated."
)
ANGLES = " Angles (″) are those of the shaft."


def report_html(
    measured: Measurement, done: Installation, where: Provenance, limits: SampleLimits | None = None
) -> str:
    found = findings(measured, done, where)
    return _page(
        where,
        found.said,
        beside("".join(map(section, found.sections)), _lissajous(measured.samples, measured.found, limits))
        + _over_speed(measured, where)
        + gallery("Pictures", _pictures(measured, done))
        + table("Origin", origins(where), style="origin"),
    )


def refusal_html(
    samples: TrackSamples, refused: CalibrationError, where: Provenance, limits: SampleLimits | None = None
) -> str:
    said = [f"refused: {refused}", "nothing was written to the module"]
    rows = [Row("samples", f"{len(samples)}; {samples.origin}"), Row("missed", str(samples.missed))]
    found = beside(table("Measurement", rows), _lissajous(samples, NO_CORRECTION, limits))
    return _page(where, said, found + table("Origin", origins(where), style="origin"), good=False)


def _page(where: Provenance, said: Sequence[str], body: str, good: bool = True) -> str:
    title = f"Reference measurement{f', encoder {where.encoder}' if where.encoder else ''}"
    footer = f"{FOOTER}{ANGLES if where.cycles_per_revolution else ''}"
    return page(title, place_line(where), said, body, footer, good)


def place_line(where: Provenance) -> str:
    words = [f"{where.date} {where.time}".strip()]
    if where.module is not None:
        words.append(f"module {where.module} ({where.module:02X}h)")
    if where.encoder_interface is not None:
        words.append(f"encoder interface {where.encoder_interface} ({where.encoder_interface:02X}h)")
    if where.cycles_per_revolution is not None:
        words.append(f"{where.cycles_per_revolution} cycles per revolution")
    return " · ".join(words)


def _lissajous(samples: TrackSamples, used: Correction, limits: SampleLimits | None) -> str:
    picture = pictures.lissajous(samples.sine, samples.cosine, used.conditioning, limits)
    seen = len(samples) - samples.missed
    dense = seen > pictures.SHOWN_SAMPLES
    shown = f"all {seen} samples, shown by their density" if dense else f"{seen} samples"
    return figure("Lissajous figure", f"should be a circle within the limits; {shown}", picture)


def _over_speed(measured: Measurement, where: Provenance) -> str:
    if measured.over_speeds is None:
        return ""
    hertz, before, after, mean, late = np.array(
        [
            (one.hertz, one.before, one.after, one.mean_before, one.mean_after)
            for one in measured.over_speeds.errors
        ],
        np.float64,  # converts None to NaN
    ).T
    per_turn = where.cycles_per_revolution
    speed, unit = (hertz * 60.0 / per_turn, "rpm") if per_turn else (hertz, "cycles/s")
    return gallery(
        "Error over the speed",
        [
            figure(
                "Error within a cycle",
                "rms at each speed, on samples that were held out",
                pictures.rms_over_speed(speed, before, after, unit),
            ),
            figure(
                "Mean error",
                "by the delay estimated from the amplitude; a delay of the converter is not included",
                pictures.mean_over_speed(speed, mean, late, unit),
            ),
        ],
    )


def _pictures(measured: Measurement, done: Installation) -> list[str]:
    calibration, on_samples = measured.calibration, measured.on_samples
    before, after = on_samples.mean_over_phase(before=True), calibration.curve.after
    noise = 100.0 * calibration.residual_rms * math.sqrt(BINS / max(1, calibration.samples_used))
    shown, which = (
        (on_samples, "of the measurement") if done.fresh is None else (done.fresh, "taken after it")
    )
    return [
        figure(
            "Correction table",
            "phase minus raw phase; Table 1 alone needs four waves of 1.1 %",
            pictures.table_curve(calibration.table, measured.before.table),
        ),
        figure(
            "Coverage",
            f"every phase must be covered{coverage_warning(measured)}",
            pictures.coverage(samples_in_bins(on_samples.phase)),
        ),
        figure(
            "Error over the phase",
            "mean in each 1/64 cycle, before and after",
            pictures.error_over_phase(before, after),
        ),
        figure(
            "Remaining error",
            f"on its own scale; noise alone gives {noise:.2g} % rms",
            pictures.remaining_error(after, calibration.uncertainty_peak),
        ),
        figure(
            "Harmonics of the error",
            "1: offset; 2: gain and phase error; 4, 8, 12: Table 1 itself",
            pictures.harmonics(before, after, calibration.residual_rms, calibration.samples_used),
        ),
        figure(
            "Deviation of single samples",
            f"{len(shown.error)} samples {which}",
            pictures.histogram(shown.error, shown.rms, calibration.noise_cycles),
        ),
    ]
