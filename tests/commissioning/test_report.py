"""The report stands alone, says what it must, and its pictures hold what was measured."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from commissioning_kit import recorded
from hypothesis import given
from hypothesis import strategies as st

from canfb.commissioning import pictures
from canfb.commissioning.access import CommissioningError
from canfb.commissioning.active import NOTHING_ACTIVE, ActiveSet
from canfb.commissioning.artefacts import prepare, write, write_refusal
from canfb.commissioning.deviation import Deviation, deviation
from canfb.commissioning.pictures import TrackLimits
from canfb.commissioning.procedure import Installation, Measurement, Settings, block_of
from canfb.commissioning.report import refusal_html, report_html
from canfb.commissioning.sample_files import read_npz
from canfb.commissioning.samples import Samples
from canfb.commissioning.summary import Circumstances, comparison
from canfb.commissioning.table_file import read_table
from canfb.errors import CalibrationError
from canfb.report.plot import Plot, Scale
from canfb.signal.conditioning import IDENTITY
from canfb.simulation.encoder import Encoder

WHERE = Circumstances("2026-03-01", 32, 16, "ROD <486> & co", 2500)
LIMITS = TrackLimits(2048, 600.0, 2300.0)
VOID = {"meta", "path", "br", "circle", "rect"}


class Page(HTMLParser):
    """Checks that what is opened is closed; keeps tags, attributes and text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.text = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture(scope="module")
def done(measured: Measurement, fresh: Samples, settings: Settings) -> Installation:
    found = deviation(fresh, measured.found, measured.before, block_of(measured.calibration), 12)
    return Installation(found, True, "1010:04")


@pytest.fixture(scope="module")
def text(measured: Measurement, done: Installation) -> str:
    return report_html(measured, done, WHERE, LIMITS)


def test_the_page_stands_alone(text: str) -> None:
    page = Page(text)
    assert not {"script", "link", "img", "iframe", "object", "embed", "base"} & set(page.tags)
    assert not {"src", "href", "data"} & {name for name, _ in page.attributes}
    assert "http" not in text
    assert "url(" not in text
    assert "@import" not in text
    assert len(text) < 300_000


def test_it_shows_every_picture_and_says_the_verdict_first(text: str, measured: Measurement) -> None:
    page = Page(text)
    assert page.tags.count("svg") == page.tags.count("figure") == 7
    assert all(value for name, value in page.attributes if name == "aria-label")
    assert page.text.index("Accepted.") < page.text.index("Before and after")
    for wanted in (
        "encoder ROD <486> & co", "2026-03-01", "module 32 (20h)", "2500 cycles per revolution",
        f"{measured.calibration.table.crc32:08X}h", "Lissajous picture", "Error over the phase",
        "Harmonics of the error", "Deviation of single samples", "Coverage", "saved (1010:04)",
    ):  # fmt: skip
        assert wanted in page.text
    assert "nan" not in re.sub(r"[A-Za-z]*nan[A-Za-z]+", "", text)


def test_light_and_dark_and_print_have_every_colour(text: str) -> None:
    defined = [set(re.findall(r"--([a-z]+):", block)) for block in re.findall(r":root \{([^}]*)\}", text)]
    used = set(re.findall(r"var\(--([a-z]+)\)", text))
    assert len(defined) == 3
    assert all(used <= one for one in defined)


def test_a_refusal_shows_the_tracks_and_the_reason(samples: Samples) -> None:
    error = CalibrationError("the tracks <hardly> change", "coverage")
    page = Page(refusal_html(samples, error, WHERE, LIMITS))
    assert "Refused: the tracks <hardly> change." in page.text
    assert "Nothing was written to the module." in page.text
    assert page.tags.count("svg") == 1


def test_a_dry_run_says_so(measured: Measurement) -> None:
    text = Page(report_html(measured, Installation(), Circumstances("2026-03-01", 32), None)).text
    assert "Dry run: nothing was written to the module." in text
    assert "fresh" not in text
    assert "″)" not in text, "no angle where the cycles per revolution are not known"


def test_the_figures_are_those_of_the_measurement(measured: Measurement, done: Installation) -> None:
    rows = {row.name: row for row in comparison(measured, done, Circumstances("2026-03-01"))}
    assert rows["table"].before == "0BEE4348h, 32 entries"
    assert float(rows["deviation, rms"].after.split()[0]) == pytest.approx(
        100 * measured.calibration.residual_rms, rel=0.01
    )
    assert float(rows["deviation, rms"].before.split()[0]) > 20 * float(
        rows["deviation, rms"].after.split()[0]
    )
    arc = Circumstances("2026-03-01", cycles_per_revolution=2500).arc_seconds(0.001)
    assert arc == pytest.approx(0.001 * 360 * 3600 / 2500)


def test_everything_is_written_and_can_be_read_again(
    measured: Measurement, done: Installation, tmp_path: Path
) -> None:
    folder = tmp_path / "a" / "b"
    prepare(folder)
    assert list(folder.iterdir()) == []
    paths = write(folder, measured, done, WHERE, LIMITS)
    assert [path.name for path in paths] == ["table.yaml", "table.bin", "samples.npz", "report.html"]
    assert (folder / "table.bin").read_bytes() == measured.calibration.table.to_bytes()
    assert read_table(folder / "table.yaml") == measured.found
    assert read_table(folder / "table.bin") == ActiveSet(measured.calibration.table, IDENTITY)
    again = read_npz(folder / "samples.npz")
    assert np.array_equal(again.sine, measured.samples.sine, equal_nan=True)
    assert again.rate_hz == measured.samples.rate_hz
    head = (folder / "table.yaml").read_text().splitlines()
    assert head[0].startswith("# Correction table of canfb: ")
    assert "date: '2026-03-01'" in head
    assert f"crc32: {measured.calibration.table.crc32:08X}" in [line.replace("'", "") for line in head]
    refused = CalibrationError("no", "ellipse")
    assert [path.name for path in write_refusal(folder, measured.samples, refused, WHERE)] == [
        "samples.npz",
        "report.html",
    ]
    assert not (folder / "table.bin").exists(), (
        "the table of an earlier run must not pass for that of this one"
    )


def test_a_folder_that_cannot_be_is_told_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(CommissioningError, match=r"cannot write to .*file/out: Not a directory"):
        prepare(tmp_path / "file" / "out")


BAD_TABLES = {
    "short.bin": b"12345",
    "empty.yaml": b"",
    "list.yaml": b"[1, 2]",
    "words.yaml": b"entries: [a, b]",
    "few.yaml": b"entries: [0, 0.5]",
    "tab.yaml": b"entries: [0,\n\t]",
    "noise.yaml": bytes(range(256)),
    "other.yaml": b"entries: ["
    + b", ".join(b"%f" % (n / 16) for n in range(16))
    + b"]\nconditioning: {gain: 1}",
}


@pytest.mark.parametrize("name", BAD_TABLES)
def test_what_is_no_table_is_told_in_one_line(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(BAD_TABLES[name])
    with pytest.raises(CommissioningError) as error:
        read_table(path)
    assert str(error.value).startswith(f"{path}: this is no correction table: ")
    assert "\n" not in str(error.value)
    with pytest.raises(CommissioningError, match="cannot be read: No such file"):
        read_table(tmp_path / "nothing.bin")


def test_a_changed_entry_is_noticed(measured: Measurement, done: Installation, tmp_path: Path) -> None:
    write(tmp_path, measured, done, WHERE)
    path = tmp_path / "table.yaml"
    path.write_text(re.sub(r"entries: \[0.0", "entries: [0.0001", path.read_text()))
    with pytest.raises(CommissioningError, match="an entry was changed"):
        read_table(path)


@given(st.floats(-100, 100), st.floats(1e-3, 1e6))
def test_ticks_are_round_inside_and_a_few(low: float, span: float) -> None:
    scale = Scale(low, low + span, 0.0, 100.0)
    ticks = scale.ticks()
    assert 2 <= len(ticks) <= 12
    assert all(scale.low - 1e-6 * span <= one <= scale.high + 1e-6 * span for one in ticks)
    assert 0.0 <= scale(low + span / 2) <= 100.0


def test_places_on_the_picture() -> None:
    scale = Scale(0.0, 10.0, 100.0, 0.0)
    assert [scale(value) for value in (0.0, 5.0, 10.0)] == [100.0, 50.0, 0.0]
    assert scale(1e9) == pytest.approx(-2.0), "held at the edge"
    log = Scale(1e-3, 1e1, 0.0, 4.0, log=True)
    assert [log(value) for value in (1e-3, 1e-1, 10.0)] == pytest.approx([0.0, 2.0, 4.0])
    assert log.ticks() == pytest.approx([1e-3, 1e-2, 1e-1, 1.0, 10.0])
    assert log(0.0) == 0.0


def test_a_line_is_broken_where_there_is_no_value() -> None:
    plot = Plot("x", (0.0, 3.0), (0.0, 1.0), ("a", "b"))
    plot.line(np.arange(4.0), np.array([0.0, np.nan, 1.0, 1.0]), "after")
    assert len(re.findall("M", re.findall(r'class="line after" d="([^"]*)"', plot.svg())[0])) == 2


def test_the_harmonics_are_those_that_are_there() -> None:
    """Orders 1, 3 and 20 of known size, means over bins: what the bars are made of."""
    fine = np.arange(64 * 200) / (64 * 200)
    sizes = {1: 0.01, 3: 0.004, 20: 0.001}
    error = sum(size * np.cos(2 * np.pi * order * fine + order) for order, size in sizes.items())
    curve = np.asarray(error).reshape(64, 200).mean(axis=1)
    found = pictures._amplitudes(curve)
    for order, size in sizes.items():
        assert found[order] == pytest.approx(size, rel=1e-3)
    curve[5] = np.nan
    assert pictures._amplitudes(curve)[1] == pytest.approx(0.01, rel=0.05)
    assert not pictures._amplitudes(np.full(64, np.nan)).any()


def test_pictures_of_nothing_and_of_perfection() -> None:
    """Edges of what can be drawn: no sample at all, no error at all."""
    nothing = Samples.of([np.nan] * 5, [np.nan] * 5, None, "nothing")
    flat = np.zeros(64)
    for svg in (
        pictures.lissajous(nothing, NOTHING_ACTIVE, LIMITS),
        pictures.lissajous(recorded(Encoder(noise_lsb=0.0), 50), NOTHING_ACTIVE, None),
        pictures.harmonics(flat, flat, 0.0, 1),
        pictures.error_over_phase(flat, np.full(64, np.nan), "x"),
        pictures.remaining_error(flat, 0.0),
        pictures.coverage(Deviation(0.0, 0.0, 0.0, 0.0, flat[:0], flat[:0], flat[:0], 0)),
    ):
        Page(svg)
        assert "nan" not in svg
        assert "inf" not in svg
