"""`canfb demo`: the same figures each time, pictures, and a clear word where there can be none."""

from __future__ import annotations

import json
import math
import os
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import pytest

from canfb.demo.story import Story
from commands import Command
from html_page import Page
from processes import python

PICTURES = ["tracks.svg", "error-over-phase.svg", "residual-over-time.svg", "servo-move.svg"]


EPOCH = "1700000000"


class Run(NamedTuple):
    code: int
    figures: dict[str, Any]
    errors: str
    folder: Path


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """One run in a process of its own, as users do it, with pictures into a folder that is not there yet."""
    folder = tmp_path_factory.mktemp("demo") / "new" / "pictures"
    dated = {**os.environ, "SOURCE_DATE_EPOCH": EPOCH}
    done = python("-m", "canfb", "demo", "--json", "--out", str(folder), env=dated)
    return Run(done.returncode, json.loads(done.stdout), done.stderr, folder)


def test_all_checks_held(run: Run) -> None:
    assert (run.code, run.errors) == (0, "")
    figures = run.figures
    assert figures["held"] is True
    assert len(figures["checks"]) == 13
    assert set(figures["checks"].values()) == {True}
    assert figures["wrong_cycle_counts"] == 0
    assert figures["faults_flagged_in_the_same_sample"] == figures["faults_provoked"] == 4
    assert figures["error_peak_before_cycles"] > 50 * figures["error_peak_after_cycles"] > 0
    assert all(math.isfinite(value) for value in figures.values() if isinstance(value, float))


def test_it_tells_the_same_each_time(
    run: Run, tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The figures, and the files byte for byte."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", EPOCH)
    said = command("demo --json --out", tmp_path)
    assert said.err == ""
    places = ("figures", "report")
    again = {key: value for key, value in said.json.items() if key not in places}
    assert again == {key: value for key, value in run.figures.items() if key not in places}
    for path in tmp_path.iterdir():
        assert path.read_bytes() == (run.folder / path.name).read_bytes(), path.name
    report = (tmp_path / "report.html").read_text("utf-8")
    assert f"canfb {version('canfb')}, 2023-11-14 22:13:20+00:00" in report


def test_four_pictures_and_a_page_are_written(run: Run) -> None:
    assert run.figures["figures"] == [str(run.folder / name) for name in PICTURES]
    assert run.figures["report"] == str(run.folder / "report.html")
    assert sorted(path.name for path in run.folder.iterdir()) == sorted([*PICTURES, "report.html"])
    for name in PICTURES:
        picture = ElementTree.fromstring((run.folder / name).read_bytes())
        assert picture.tag == "{http://www.w3.org/2000/svg}svg"
        drawn = sum(len(one.get("d", "")) for one in picture.iter("{http://www.w3.org/2000/svg}path"))
        assert 2000 < drawn < 200_000
        assert "nan" not in {one.get("d") for one in picture.iter()}


def test_the_page_stands_alone_and_has_the_figures(run: Run) -> None:
    text = (run.folder / "report.html").read_text(encoding="utf-8")
    assert len(text) < 300_000
    page = Page(text)
    assert not {"script", "link", "img", "iframe", "object", "embed", "base"} & set(page.tags)
    assert not {"src", "href", "data"} & {name for name, _ in page.attributes}
    assert page.tags.count("svg") == page.tags.count("figure") == 5
    assert ("class", "verdict bad") not in page.attributes
    for words in ("All checks passed.", *run.figures["checks"]):
        assert words in page.text
    assert f"{run.figures['samples']} samples" in page.text
    assert f"CRC-32 {run.figures['table_crc32']}h" in page.text
    assert f"{100 * run.figures['error_rms_after_cycles']:.4f}" in page.text


def test_a_wrong_date_and_a_wrong_folder_are_found_before_the_work(
    tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("canfb.demo.story.DemoNetwork", None)
    file = tmp_path / "a file"
    file.write_text("")
    for path, why in ((file, "File exists"), (file / "below", "Not a directory")):
        assert command("demo --out", path, code=1).err == f"canfb: {path}: cannot be written: {why}\n"
    for wrong in ("today", "", "9" * 30):
        monkeypatch.setenv("SOURCE_DATE_EPOCH", wrong)
        assert "seconds since 1970 are required" in command("demo --out", tmp_path, code=2).err


def test_a_story_that_does_not_hold_is_exit_code_1(monkeypatch: pytest.MonkeyPatch, command: Command) -> None:
    checks = {"it flies": False, "it floats": True}
    told = Story(checks=checks)
    monkeypatch.setattr("canfb.demo.story.run_story", lambda network: told)
    monkeypatch.setattr(
        "canfb.demo.demo_page.figures", lambda told: {"held": told.held, "checks": told.checks}
    )
    assert command("demo --json", code=1).json == {"held": False, "checks": checks, "figures": []}
