"""The simulated analog path against filters in the time domain, and in the module that removes it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from canfb.simulation.encoder import AnalogPath, Encoder, Harmonic, ShaftEncoder
from canfb.simulation.motion import Motion

HERTZ = 125e3


def one_pole(track: np.ndarray, step_s: float, corner_hz: float) -> np.ndarray:
    """The exact response of a low-pass to a track that is held between its points."""
    part = 1.0 - math.exp(-2.0 * math.pi * corner_hz * step_s)
    out, value = np.empty(len(track)), float(track[0])
    for k, given in enumerate(track.tolist()):
        out[k] = value
        value += part * (given - value)
    return out


def test_the_steady_response_is_that_of_the_filter() -> None:
    step_s = 1e-9
    time = np.arange(80_000) * step_s
    plain = Encoder(harmonics=(Harmonic(3, 0.05, 0.03, 0.4, 1.0),), sine_offset=0.1)
    path = AnalogPath(sine_corner_hz=125e3, cosine_corner_hz=80e3, cosine_delay_s=1e-6)
    sine, cosine = plain.tracks(HERTZ * time)
    wanted = one_pole(sine, step_s, 125e3), one_pole(cosine, step_s, 80e3)
    steady = Encoder(harmonics=plain.harmonics, sine_offset=0.1, path=path)
    at = slice(50_000, 78_000)
    ours = steady.tracks(HERTZ * time[at], HERTZ)
    assert ours[0] == pytest.approx(wanted[0][at], abs=3.0)  # of 1500 counts, 1 ns
    assert ours[1] == pytest.approx(wanted[1][51_000:79_000], abs=3.0)


def test_a_standing_machine_has_the_tracks_of_the_encoder() -> None:
    plain = Encoder(harmonics=(Harmonic(3, 0.05, 0.03),), phase_error_rad=0.1)
    filtered = Encoder(
        harmonics=plain.harmonics, phase_error_rad=0.1, path=AnalogPath(sine_corner_hz=1e5, delay_s=1e-6)
    )
    x = np.linspace(0.0, 1.0, 50)
    for one, other in zip(plain.tracks(x), filtered.tracks(x), strict=True):
        assert one == pytest.approx(other, abs=1e-9)


@pytest.mark.parametrize(
    "path", [AnalogPath(sine_corner_hz=125e3, cosine_corner_hz=125e3), AnalogPath(delay_s=2e-6)]
)
def test_the_lag_is_that_of_the_phase(path: AnalogPath) -> None:
    encoder = Encoder(path=path)
    sine, cosine = encoder.tracks(0.3, HERTZ)
    shown = math.atan2(float(sine), float(cosine)) / (2.0 * math.pi) % 1.0
    assert 0.3 - shown == pytest.approx(HERTZ * path.lag_s(HERTZ), abs=1e-12)
    assert path.lag_s(0.0) == pytest.approx(path.lag_s(1.0), rel=1e-6)


def test_a_shaft_knows_its_speed() -> None:
    path = AnalogPath(sine_corner_hz=125e3, cosine_corner_hz=125e3)
    shaft = ShaftEncoder(Encoder(path=path), 2500)
    motion = Motion((), start_rpm=3000.0)
    amplitudes = [math.hypot(*shaft.sample(k * 1e-3, motion.revolutions)[:2]) for k in range(1, 20)]
    assert np.mean(amplitudes) == pytest.approx(1500.0 / math.sqrt(2.0), rel=1e-3)
