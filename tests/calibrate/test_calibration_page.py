"""The report stands alone, says what it must and where it is from; its pictures hold what was measured."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from canfb.calibrate.artefacts import refusal_html, report_html, write, write_refusal
from canfb.calibrate.calibration_summary import bound_words, comparison, facts, findings
from canfb.calibrate.choices import CalibrateOptions
from canfb.calibrate.measurement import Measurement, Settings, block_of
from canfb.calibrate.procedure import Installation
from canfb.calibration.deviation import Deviation, best_deviation
from canfb.errors import CalibrationError
from canfb.files import prepare_folder
from canfb.master.access import CommissioningError
from canfb.master.machine_watch import Provenance
from canfb.master.samples import TrackSamples, read_npz, write_npz
from canfb.sdo.tables import read_table
from canfb.signal.conditioning import IDENTITY
from canfb.signal.correction import Correction
from canfb.signal.supervision import SampleLimits
from folding import each
from html_page import Page

WHERE = Provenance(
    "2026-03-01",
    32,
    16,
    "ROD <486> & co",
    2500,
    time="14:03:22+01:00",
    version="1.2.3",
    command="canfb calibrate -c can0 --encoder 'X & Y'",
    identity=(0, 1, 65536, 4711),
    interface_identity=(0, 2),
)
LIMITS = SampleLimits(2048, 600.0, 2300.0)


@pytest.fixture(scope="module")
def done(measured: Measurement, fresh: TrackSamples, settings: Settings) -> Installation:
    found = best_deviation(
        fresh.recording(12), measured.found, measured.before, block_of(measured.calibration)
    )
    return Installation(found, "1010:04")


@pytest.fixture(scope="module")
def text(measured: Measurement, done: Installation) -> str:
    return report_html(measured, done, WHERE, LIMITS)


def test_it_shows_every_picture_and_says_the_verdict_first(text: str, measured: Measurement) -> None:
    page = Page(text)
    assert len(text) < 300_000
    assert page.tags.count("svg") == page.tags.count("figure") == 7
    assert all(value for name, value in page.attributes if name == "aria-label")
    assert page.text.index("Accepted.") < page.text.index("Before and after")
    for wanted in (
        "encoder ROD <486> & co", "2026-03-01", "module 32 (20h)", "2500 cycles per revolution",
        f"{measured.calibration.table.crc32:08X}h", "Lissajous figure", "Error over the phase",
        "Harmonics of the error", "Deviation of single samples", "Coverage", "saved (1010:04)",
    ):  # fmt: skip
        assert wanted in page.text
    assert "nan" not in re.sub(r"[A-Za-z]*nan[A-Za-z]+", "", text)


def test_a_refusal_shows_the_tracks_and_the_reason(samples: TrackSamples) -> None:
    error = CalibrationError("the tracks <hardly> change", "coverage")
    page = Page(refusal_html(samples, error, WHERE, LIMITS))
    assert "Refused: the tracks <hardly> change." in page.text
    assert "Nothing was written to the module." in page.text
    assert page.tags.count("svg") == 1


def test_a_dry_run_says_so(measured: Measurement) -> None:
    text = Page(report_html(measured, Installation(), Provenance("2026-03-01", 32), None)).text
    assert "Dry run: nothing was written to the module." in text
    assert "fresh" not in text
    assert "″)" not in text, "no angle where the cycles per revolution are not known"


def test_the_figures_are_those_of_the_measurement(measured: Measurement, done: Installation) -> None:
    rows = {row.name: row for row in comparison(measured, done, Provenance("2026-03-01"))}
    assert rows["table"].words[0] == "0BEE4348h, 32 entries"
    assert float(rows["deviation, rms"].words[1].split()[0]) == pytest.approx(
        100 * measured.calibration.residual_rms, rel=0.01
    )
    assert float(rows["deviation, rms"].words[0].split()[0]) > 20 * float(
        rows["deviation, rms"].words[1].split()[0]
    )
    arc = Provenance("2026-03-01", cycles_per_revolution=2500).arc_seconds(0.001)
    assert arc == pytest.approx(0.001 * 360 * 3600 / 2500)


def test_everything_is_written_and_can_be_read_again(
    measured: Measurement, done: Installation, tmp_path: Path
) -> None:
    folder = tmp_path / "a" / "b"
    prepare_folder(folder, "calibrate")
    assert list(folder.iterdir()) == []
    paths = write(folder, measured, done, WHERE, LIMITS)
    assert [path.name for path in paths] == ["table.yaml", "table.bin", "samples.npz", "report.html"]
    assert (folder / "table.bin").read_bytes() == measured.calibration.table.to_bytes()
    assert read_table(folder / "table.yaml").used == measured.found
    assert read_table(folder / "table.bin").used == Correction(measured.calibration.table, IDENTITY)
    again = read_npz(folder / "samples.npz")
    assert np.array_equal(again.sine, measured.samples.sine, equal_nan=True)
    assert again.rate_hz == measured.samples.rate_hz
    time_s = np.arange(len(again)) / 1e3
    write_npz(tmp_path / "t.npz", replace(again, time_s=time_s))
    (tmp_path / "t.npz").rename(tmp_path / "T.NPZ")
    assert np.all(CalibrateOptions().samples_of_file(tmp_path / "T.NPZ").time_s == time_s)
    content = (folder / "table.yaml").read_text()
    assert content.startswith("# Correction table of canfb: ")
    head = yaml.safe_load(content)
    assert (head["date"], head["time"], head["canfb"]) == ("2026-03-01", "14:03:22+01:00", "1.2.3")
    assert head["module_identity"] == [0, 1, 65536, 4711]
    assert head["crc32"] == f"{measured.calibration.table.crc32:08X}"
    refused = CalibrationError("no", "ellipse")
    write_refusal(folder, measured.samples, refused, WHERE)
    assert {path.name for path in folder.iterdir()} == {"samples.npz", "report.html"}, (
        "the table of an earlier run must not pass for that of this one"
    )


BAD_TABLES = {
    "short.bin": b"12345",
    "empty.yaml": b"",
    "list.yaml": b"[1, 2]",
    "few.yaml": b"entries: [0, 0.5]",
    "tab.yaml": b"entries: [0,\n\t]",
    "noise.yaml": bytes(range(256)),
}


@pytest.mark.parametrize("name", BAD_TABLES)
def test_what_is_no_table_is_told_in_one_line(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(BAD_TABLES[name])
    with pytest.raises(CommissioningError) as error:
        read_table(path)
    assert str(error.value).startswith(f"{path}: this is not a correction table: ")
    assert "\n" not in str(error.value)
    with pytest.raises(CommissioningError, match="cannot be read: No such file"):
        read_table(tmp_path / "nothing.bin")


def test_the_report_says_when_with_what_and_how(text: str, measured: Measurement) -> None:
    for page in (text, refusal_html(measured.samples, CalibrationError("no", "ellipse"), WHERE)):
        assert "2026-03-01 14:03:22+01:00" in page
        assert "canfb 1.2.3" in page
        assert "canfb calibrate -c can0 --encoder &#x27;X &amp; Y&#x27;" in page
        assert "32 (20h); vendor 0, product 1, revision 65536, serial number 4711 (1018h)" in page
        assert "16 (10h); vendor 0, product 2 (1018h)" in page
    figures = json.loads(json.dumps(findings(measured, Installation(), WHERE).to_json()))
    assert (figures["time"], figures["canfb"]) == ("14:03:22+01:00", "1.2.3")
    assert figures["module_identity"] == [0, 1, 65536, 4711]


def deviation_at(phase: np.ndarray) -> Deviation:
    nothing = np.zeros(len(phase))
    return Deviation(1e-4, 1e-3, 1e-2, 2e-2, phase, nothing, nothing, 0)


def test_a_spike_of_the_coverage_is_said(measured: Measurement) -> None:
    rng = np.random.default_rng(2)
    even = rng.uniform(0, 1, 6400)
    assert deviation_at(even).spike is None
    assert deviation_at(even[:200]).spike is None, "chance"
    assert deviation_at(even[:0]).spike is None
    spiky = deviation_at(np.concatenate([even, np.full(400, 0.3)]))
    assert spiky.spike == (pytest.approx(5.0, rel=0.2), pytest.approx(0.3, abs=0.5 / 64))
    bad = replace(measured, on_samples=spiky)
    (words,) = next(row.words for row in facts(bad, Installation(), WHERE) if row.name == "coverage")
    assert re.search(r"; spiky: \d\.\d times the mean at phase 0\.30, another speed is better$", words)
    page = report_html(bad, Installation(), WHERE)
    assert "every phase must be covered; spiky: " in page
    assert findings(bad, Installation(), WHERE).to_json()["coverage_spike"] == pytest.approx(5.0, rel=0.2)
    assert "spiky" not in report_html(measured, Installation(), WHERE)


@each("ratio, scatter, words", [
    (0.66, 0.3, "0.66 ± 0.20 times the Cramér-Rao bound: as small as these samples allow"),
    (1.3, 0.15, "1.30 ± 0.20 times the Cramér-Rao bound: as small as these samples allow"),
    (
        3.0,
        0.15,
        "3.00 ± 0.45 times the Cramér-Rao bound: more than the noise of the converter; motion or ",
    ),
])  # fmt: skip
def test_a_ratio_below_one_is_chance_and_one_far_above_is_not(
    measured: Measurement, ratio: float, scatter: float, words: str
) -> None:
    found = replace(measured.calibration, cramer_rao_ratio=ratio, cramer_rao_scatter=scatter)
    assert bound_words(found).startswith(words)
