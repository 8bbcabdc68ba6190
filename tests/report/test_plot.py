"""Scales have round ticks, and what is drawn is where its values are."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.report.plot import Plot, Scale


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
