"""The demo's pictures and page show the story that was told."""

from __future__ import annotations

import re
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from canfb.demo import demo_page
from canfb.demo.demo_page import error_after, error_before, residual, servo, tracks
from canfb.demo.story import FAULT_SAMPLES, FAULTS, LOST_SAMPLE, Story
from canfb.report.plot import Plot
from canfb.rows import Row
from canfb.simulation.encoder import Encoder
from html_page import Page


def story() -> Story:
    phase = np.linspace(0.0, 0.99, 100)
    return Story(
        error_before=0.02 * np.sin(6.28 * phase),
        error_after=0.0002 * np.cos(6.28 * phase),
        phase_before=phase,
        phase_after=phase,
        residual_number=np.arange(FAULT_SAMPLES),
        residual=np.where(np.isin(np.arange(FAULT_SAMPLES), list(FAULTS)), 0.5, 0.01),
        fault_window=(900, 900 + FAULT_SAMPLES),
        checks={"it flies": True},
    )


def network() -> Any:
    angle = 0.7 * np.arange(1000)
    tracks = np.rint(1500 * np.sin(angle)), np.rint(1500 * np.cos(angle))
    for track in tracks:
        track[900 + LOST_SAMPLE] = np.nan
    return SimpleNamespace(recorder=SimpleNamespace(tracks=lambda: tracks), encoder=Encoder())


def test_each_fault_is_ringed_and_named_once() -> None:
    svg = tracks(network(), story()).svg()
    assert svg.count("<circle ") == len(FAULTS) - 1
    for place, (name, _) in FAULTS.items():
        assert svg.count(f">{name}</text>") == (place != LOST_SAMPLE)


def test_the_names_of_the_faults_do_not_cross() -> None:
    """Each is right of its line and below the one before; its line ends there."""
    svg = residual(story()).svg()
    places = [re.search(rf'<text x="([\d.]+)" y="([\d.]+)"[^>]*>{name}<', svg) for name, _ in FAULTS.values()]
    found = [(float(place[1]), float(place[2])) for place in places if place]
    assert len(found) == len(FAULTS)
    assert found == sorted(found)
    assert all(below - above > 14.0 for (_, above), (_, below) in pairwise(found))


@pytest.mark.parametrize("draw", [error_before, error_after])
def test_no_error_is_beyond_the_picture(draw: Any) -> None:
    plot: Plot = draw(story())
    points = re.findall(r"M([\d.]+) ([\d.]+)h0", plot.drawing())
    assert len(points) == 100
    top, bottom = plot.y(plot.y.high), plot.y(plot.y.low)
    assert all(top < float(y) < bottom for _, y in points)


def test_a_story_that_did_not_hold_is_shown_as_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo_page, "run_facts", lambda told: [Row("samples", "3")])
    good, bad = story(), story()
    bad.checks = {"it flies": True, "it <floats>": False}
    pages = [
        Page(
            demo_page.demo_page(
                told,
                "canfb 1.2.3, 2026-11-22 <b>",
                (residual(told), error_before(told), error_after(told), residual(told), servo(told)),
            )
        )
        for told in (good, bad)
    ]
    assert "All checks passed." in pages[0].text
    assert ("class", "verdict bad") not in pages[0].attributes
    assert all("canfb 1.2.3, 2026-11-22 <b>" in page.text for page in pages)
    assert "Failed: it <floats>." in pages[1].text
    assert ("class", "verdict bad") in pages[1].attributes
    assert [page.tags.count("figure") for page in pages] == [5, 5]


def test_there_is_no_page_of_a_story_that_has_not_been_told() -> None:
    told = story()
    with pytest.raises(ValueError, match="has not run"):
        demo_page.demo_page(told, "", (residual(told),) * 5)
