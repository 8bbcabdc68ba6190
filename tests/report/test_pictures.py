"""The pictures hold what was measured, and can be drawn at their edges."""

from __future__ import annotations

import numpy as np
import pytest

from canfb.report import pictures
from canfb.report.pictures import lissajous
from canfb.signal.conditioning import IDENTITY
from canfb.signal.supervision import SampleLimits
from canfb.simulation.encoder import Encoder
from html_page import Page

LIMITS = SampleLimits(2048, 600.0, 2300.0)


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
        lissajous(nothing, nothing, IDENTITY, LIMITS),
        lissajous(*tracks, IDENTITY, None),
        pictures.harmonics(flat, flat, 0.0, 1),
        pictures.error_over_phase(flat, np.full(64, np.nan), "x"),
        pictures.remaining_error(flat, 0.0),
        pictures.coverage(np.zeros(64, np.int64)),
    ):
        Page(svg)
        assert "nan" not in svg
        assert "inf" not in svg
