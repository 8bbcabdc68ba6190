"""Scales have round ticks, and what is drawn is where its values are."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.report.plot import Plot
from canfb.report.scale import Scale


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
