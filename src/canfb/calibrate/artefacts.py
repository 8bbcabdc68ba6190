"""What a reference measurement leaves in a folder: table, samples, report."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from canfb.calibrate.calibration_page import refusal_html, report_html
from canfb.calibrate.calibration_summary import figures as figures_of
from canfb.calibrate.measurement import Measurement
from canfb.calibrate.procedure import Installation
from canfb.errors import CalibrationError
from canfb.master.access import CommissioningError
from canfb.master.machine_watch import Provenance
from canfb.master.samples import TrackSamples, write_npz
from canfb.sdo.table_file import as_yaml
from canfb.signal.supervision import SampleLimits

TABLE_YAML, TABLE_BIN, SAMPLES, REPORT = "table.yaml", "table.bin", "samples.npz", "report.html"
SPEEDS = "speeds"
# What is in the YAML beyond crc32, conditioning and entries.
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


@contextlib.contextmanager
def _writing(place: Path) -> Iterator[None]:
    """CommissioningError for what cannot be written in here."""
    try:
        yield
    except OSError as error:
        raise CommissioningError(f"cannot write to {place}: {error.strerror}") from None


def prepare(folder: Path) -> None:
    """Make the folder. CommissioningError if it cannot be made or written to: before the work starts."""
    with _writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f".{REPORT}"
        probe.touch()
        probe.unlink()


def write(
    folder: Path,
    measured: Measurement,
    done: Installation,
    where: Provenance,
    limits: SampleLimits | None = None,
) -> list[Path]:
    """Write everything; the paths. CommissioningError if that does not work."""
    figures = figures_of(measured, done, where)
    meta = {key: figures[key] for key in META if figures.get(key) is not None}
    with _writing(folder):
        (folder / TABLE_YAML).write_text(as_yaml(measured.found, meta), encoding="utf-8")
        (folder / TABLE_BIN).write_bytes(measured.calibration.table.to_bytes())
        write_npz(folder / SAMPLES, measured.samples)
        page = report_html(measured, done, where, limits)
        (folder / REPORT).write_text(page, encoding="utf-8")
    return [folder / name for name in (TABLE_YAML, TABLE_BIN, SAMPLES, REPORT)]


def keep_samples(folder: Path, samples: TrackSamples) -> Path:
    """Write the samples alone; their path. CommissioningError if that does not work."""
    with _writing(folder):
        write_npz(folder / SAMPLES, samples)
    return folder / SAMPLES


def keep_speeds(folder: Path, measured: Sequence[tuple[TrackSamples, float]]) -> list[Path]:
    """Write the samples of each speed (cycles/s) to a folder in the folder; their paths."""
    place = folder / SPEEDS
    paths = [place / f"{number:02d}.npz" for number in range(1, len(measured) + 1)]
    with _writing(place):
        place.mkdir(exist_ok=True)
        for old in place.glob("*.npz"):  # of an earlier run
            old.unlink()
        for path, (samples, hertz) in zip(paths, measured, strict=True):
            write_npz(path, samples, hertz)
    return paths


def write_refusal(
    folder: Path,
    samples: TrackSamples,
    refused: CalibrationError,
    where: Provenance,
    limits: SampleLimits | None = None,
) -> list[Path]:
    """Samples and report of a measurement that was refused: they show why. There is no table."""
    with _writing(folder):
        for name in (TABLE_YAML, TABLE_BIN):  # of an earlier run: they must not pass for those of this one
            (folder / name).unlink(missing_ok=True)
        write_npz(folder / SAMPLES, samples)
        (folder / REPORT).write_text(refusal_html(samples, refused, where, limits), encoding="utf-8")
    return [folder / name for name in (SAMPLES, REPORT)]
