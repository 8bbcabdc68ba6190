"""Pages and SVG files escape what they are given, stand alone, and have every colour."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np

from canfb.report.page import DRAWING, HEADING, PAGE, ROW, beside, figure, gallery, page, svg_file, table
from canfb.report.plot import Plot
from canfb.rows import Row
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
