"""An SVG file is whole by itself: XML, headings, legends, and colours for light and dark."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np

from canfb.report.page import HEADING, ROW, svg_file
from canfb.report.plot import Plot

SVG = "{http://www.w3.org/2000/svg}"
NASTY = "a <b> & 'c'"


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


def test_it_refers_to_nothing_and_has_every_colour() -> None:
    text = svg_file([("x", plot())])
    assert not re.search(r"<script|href|url\(|@import", text)
    assert text.count("http") == 1, "the name space"
    defined = [set(re.findall(r"--([a-z]+):", block)) for block in re.findall(r":root \{([^}]*)\}", text)]
    used = set(re.findall(r"var\(--([a-z]+)\)", text))
    assert len(defined) == 3
    assert all(used <= one for one in defined)
