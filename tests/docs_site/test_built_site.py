"""The check of the built site: dead links, missing anchors, files of other addresses."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.site.built import faults_in


def build(folder: Path, body: str, css: str = "") -> list[str]:
    (folder / "a.html").write_text(f"<html><body>{body}</body></html>", encoding="utf-8")
    (folder / "b.html").write_text('<h1 id="there">B</h1>', encoding="utf-8")
    (folder / "a.css").write_text(css, encoding="utf-8")
    return list(faults_in(folder))


@pytest.mark.parametrize(
    "body",
    [
        '<a href="b.html">',
        '<a href="b.html#there">',
        '<a href="#own"><p id="own">',
        '<a href="https://example.org/x">',
        '<script src="a.css?v=1"></script>',
        '<a href="mailto:a@example.org">',
        '<img src="data:image/png;base64,AA==">',
    ],
)
def test_what_is_right_passes(tmp_path: Path, body: str) -> None:
    assert build(tmp_path, body, "p { background: url(data:image/png;base64,AA==) }") == []


@pytest.mark.parametrize(
    ("body", "fault"),
    [
        ('<a href="c.html">', "a.html: c.html leads nowhere"),
        ('<a href="b.html#gone">', "a.html: b.html#gone leads nowhere"),
        ('<a href="#gone">', "a.html: #gone leads nowhere"),
        ('<img src="gone.svg">', "a.html: gone.svg leads nowhere"),
        (
            '<script src="https://e.org/x.js"></script>',
            "a.html: loads https://e.org/x.js from another address",
        ),
        ('<link href="//e.org/x.css">', "a.html: loads //e.org/x.css from another address"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, body: str, fault: str) -> None:
    assert build(tmp_path, body) == [fault]


@pytest.mark.parametrize("css", ["@import 'https://e.org/f.css';", "p { src: url(https://e.org/f.css) }"])
def test_a_style_loads_nothing_from_another_address(tmp_path: Path, css: str) -> None:
    assert build(tmp_path, "", css) == ["a.css: loads https://e.org/f.css from another address"]
