"""The pictures hold what was measured, leave no sample out, and can be drawn at their edges."""

from __future__ import annotations

import re

import numpy as np
import pytest

from canfb.report import pictures
from canfb.report.pictures import SHADES, SHOWN_SAMPLES, lissajous
from canfb.signal.conditioning import IDENTITY
from canfb.signal.phase import FloatArray
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
