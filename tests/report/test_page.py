"""A page escapes what it is given, stands alone, and has every colour in light, dark and print."""

from __future__ import annotations

import re

from canfb.report.page import DRAWING, PAGE, beside, figure, gallery, page, table
from canfb.rows import Row
from html_page import Page

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


def test_it_stands_alone() -> None:
    found = Page(whole())
    assert not {"script", "link", "img", "iframe", "object", "embed", "base"} & set(found.tags)
    assert not {"src", "href", "data"} & {name for name, _ in found.attributes}


def test_every_colour_is_there_in_light_dark_and_print() -> None:
    defined = [set(re.findall(r"--([a-z]+):", block)) for block in re.findall(r":root \{([^}]*)\}", whole())]
    used = set(re.findall(r"var\(--([a-z]+)\)", DRAWING + PAGE))
    assert len(defined) == 3
    assert all(one == used for one in defined)
