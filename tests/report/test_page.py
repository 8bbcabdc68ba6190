"""Pages, plots and pictures: they escape what they are given, stand alone, and hold what was measured."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, strategies as st

from canfb.report import pictures
from canfb.report.page import DRAWING, HEADING, PAGE, ROW, beside, figure, gallery, page, svg_file, table
from canfb.report.pictures import SHADES, SHOWN_SAMPLES, lissajous
from canfb.report.plot import Plot, Scale
from canfb.rows import Row
from canfb.signal.conditioning import IDENTITY
from canfb.signal.phase import FloatArray
from canfb.signal.supervision import SampleLimits
from canfb.simulation.encoder import Encoder
from html_page import Page

SVG = "{http://www.w3.org/2000/svg}"
NASTY = "<b>&\"'"


def whole() -> str:
    picture = figure(NASTY, NASTY, "<svg></svg>")
    tables = table(NASTY, [Row(NASTY, NASTY)], style="origin")
    tables += table(NASTY, [Row(NASTY, NASTY, NASTY)], (NASTY, NASTY))
    body = beside(tables, picture) + gallery(NASTY, [picture, picture])
    return page(NASTY, NASTY, [NASTY, NASTY], body, NASTY, good=False)


def test_text_stays_text() -> None:
    found = Page(whole())
    assert "b" not in found.tags
    assert found.text.count(NASTY) == 6 + 3 + 6 + 6 + 1
    assert found.tags.count("figure") == 3
    assert ("class", "verdict bad") in found.attributes
    assert ("class", "verdict") in Page(page("a", "b", ["c"], "", "d")).attributes
    assert b"<h1>\\udcff</h1>" in page("\udcff", "b", ["c"], "", "d").encode()  # the name of a file


def plot() -> Plot:
    plot = Plot(NASTY, (0.0, 10.0), (0.0, 10.0), (NASTY, NASTY))
    x = np.array([2.0, 4.0])
    plot.line(x, x, "limit dashed", "a line")
    plot.dots(x, x, "after", "dots")
    plot.bars(x, x, 1.0, "before", "bars")
    plot.rings(x, x, "before", "rings")
    plot.note(2.0, 4.0, NASTY, "before end", (3.0, -4.0))
    return plot


def test_it_is_xml_with_all_that_was_drawn() -> None:
    root = ElementTree.fromstring(svg_file([(NASTY, plot()), ("second", plot())]))
    words = [one.text for one in root.iter(f"{SVG}text")]
    assert words[0] == NASTY
    assert words.count("second") == 1
    assert words.count(NASTY) == 1 + 2 * 3, "heading; axes and note of each"
    for name in ("a line", "dots", "bars", "rings"):
        assert words.count(name) == 2
    assert len(list(root.iter(f"{SVG}circle"))) == 2 * (2 + 1), "of each: two rings, and one in the legend"


def test_it_has_the_size_of_its_parts() -> None:
    one, both = (
        float(ElementTree.fromstring(svg_file([("x", plot())] * n)).attrib["height"]) for n in (1, 2)
    )
    assert one >= HEADING + plot().height + 4 * ROW
    assert both == 2 * one


def test_it_stands_alone_and_has_every_colour_in_light_dark_and_print() -> None:
    found = Page(whole())
    assert not {"script", "link", "img", "iframe", "object", "embed", "base"} & set(found.tags)
    assert not {"src", "href", "data"} & {name for name, _ in found.attributes}
    file = svg_file([("x", plot())])
    assert not re.search(r"<script|href|url\(|@import", file)
    assert file.count("http") == 1, "the name space"
    used = set(re.findall(r"var\(--([a-z]+)\)", DRAWING + PAGE))
    for text in (whole(), file):
        defined = [set(re.findall(r"--([a-z]+):", block)) for block in re.findall(r":root \{([^}]*)\}", text)]
        assert defined == [used] * 3


@given(st.floats(-100, 100), st.floats(1e-3, 1e6))
def test_ticks_are_round_inside_and_a_few(low: float, span: float) -> None:
    scale = Scale(low, low + span, 0.0, 100.0)
    ticks = scale.ticks()
    assert 3 <= len(ticks) <= 8, "enough to read a value"
    steps = np.diff(ticks) / 10.0 ** np.floor(np.log10(ticks[1] - ticks[0]) + 1e-6)
    assert steps == pytest.approx(min((1.0, 2.0, 2.5, 5.0), key=lambda one: abs(one - steps[0])), rel=1e-6)
    assert all(scale.low - 1e-6 * span <= one <= scale.high + 1e-6 * span for one in ticks)
    assert 0.0 <= scale(low + span / 2) <= 100.0


def test_places_on_the_picture() -> None:
    scale = Scale(0.0, 10.0, 100.0, 0.0)
    assert [scale(value) for value in (0.0, 5.0, 10.0)] == [100.0, 50.0, 0.0]
    assert scale(1e9) == pytest.approx(-2.0), "held at the edge"
    assert Scale(-2.7, 2.7, 0.0, 1.0).ticks() == pytest.approx([-2.0, -1.0, 0.0, 1.0, 2.0]), "not three"
    log = Scale(1e-3, 1e1, 0.0, 4.0, log=True)
    assert [log(value) for value in (1e-3, 1e-1, 10.0)] == pytest.approx([0.0, 2.0, 4.0])
    assert log.ticks() == pytest.approx([1e-3, 1e-2, 1e-1, 1.0, 10.0])
    assert log(0.0) == 0.0


def test_a_line_is_broken_where_there_is_no_value() -> None:
    plot = Plot("x", (0.0, 3.0), (0.0, 1.0), ("a", "b"))
    plot.line(np.arange(4.0), np.array([0.0, np.nan, 1.0, 1.0]), "after")
    assert len(re.findall("M", re.findall(r'class="line after" d="([^"]*)"', plot.svg())[0])) == 2


def test_rings_and_notes_are_at_their_points() -> None:
    plot = Plot("x", (0.0, 10.0), (0.0, 10.0), ("a", "b"))
    plot.rings(np.array([5.0, 10.0]), np.array([5.0, 10.0]), "before", "rings")
    plot.note(5.0, 5.0, "here", "before end", (-9.0, 4.0))
    svg = plot.svg()
    x, y = plot.x(5.0), plot.y(5.0)
    assert f'<circle class="ring before" cx="{x:.1f}" cy="{y:.1f}" r="6"/>' in svg
    assert f'<text x="{x - 9.0:.1f}" y="{y + 4.0:.1f}" class="note before end">here</text>' in svg
    assert [key.name for key in plot.legend] == ["rings"]
    assert svg.count("ring-key") == 1


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
    nothing, flat = np.full(5, np.nan), np.zeros(64)
    tracks = Encoder(noise_lsb=0.0).tracks(np.arange(50) / 50)
    for svg in (
        lissajous(nothing, nothing, IDENTITY, SampleLimits(2048, 600.0, 2300.0)),
        lissajous(*tracks, IDENTITY, None),
        pictures.harmonics(flat, flat, 0.0, 1),
        pictures.error_over_phase(flat, np.full(64, np.nan)),
        pictures.remaining_error(flat, 0.0),
        pictures.coverage(np.zeros(64, np.int64)),
    ):
        Page(svg)
        assert "nan" not in svg
        assert "inf" not in svg


def dots_of(svg: str) -> list[tuple[float, float]]:
    paths = re.findall(r'class="dots [^"]*"[^>]* d="([^"]*)"', svg)
    return [(float(x), float(y)) for path in paths for x, y in re.findall(r"M([-\d.]+) ([-\d.]+)h0", path)]


def ring(n: int, noise: float = 0.5) -> tuple[FloatArray, FloatArray]:
    """Sine and cosine, counts."""
    rng = np.random.default_rng(1)
    angle = rng.uniform(0, 2 * np.pi, n)
    sine, cosine = (1000 * f(angle) + noise * rng.standard_normal(n) for f in (np.sin, np.cos))
    return sine, cosine


@pytest.mark.parametrize("n", [100, 4000])
def test_a_few_thousand_samples_are_drawn_each(n: int) -> None:
    assert len(dots_of(lissajous(*ring(n), IDENTITY, None))) == n


@pytest.mark.parametrize("noise", [0.5, 300.0])
def test_more_are_drawn_by_their_density_and_none_is_left_out(noise: float) -> None:
    sine, cosine = ring(60_000, noise)
    sine[31_234], cosine[31_234] = 0.0, 0.0  # one fault
    sine[777] = np.nan
    svg = lissajous(sine, cosine, IDENTITY, None)
    dots = np.array(dots_of(svg))
    assert 300 < len(dots) <= SHOWN_SAMPLES
    assert len(svg) < 90_000
    assert len(set(re.findall(r"stroke-opacity:([\d.]+)", svg))) == SHADES
    centre = (dots.min(axis=0) + dots.max(axis=0)) / 2
    nearest = np.abs(dots - centre).max(axis=1).min()
    assert nearest < 12.0, "the fault in the middle of the ring"


def test_a_circle_is_drawn_as_one() -> None:
    """Both axes have one scale: an ellipse in the picture is one of the tracks."""
    dots = np.array(dots_of(lissajous(*ring(4000, noise=0.0), IDENTITY, None)))
    width, height = dots.max(axis=0) - dots.min(axis=0)
    assert width == pytest.approx(height, abs=0.3)
