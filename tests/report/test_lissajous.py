"""The Lissajous figure leaves out no sample, and a circle is drawn as one."""

from __future__ import annotations

import re

import numpy as np
import pytest

from canfb.report.pictures import SHADES, SHOWN_SAMPLES, lissajous
from canfb.signal.conditioning import IDENTITY
from canfb.signal.phase import FloatArray


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
