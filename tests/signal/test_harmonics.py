"""What the analog path does to the harmonics: the arithmetic against simulated tracks."""

from __future__ import annotations

import numpy as np
import pytest

from canfb.calibration.ellipse import with_track_harmonics
from canfb.signal.conditioning import Conditioning
from canfb.signal.front_end import NO_LOW_PASS, PLACES, SPEEDS, Corners, FrontEnd, corrected, harmonic_rows
from canfb.simulation.encoder import AnalogPath, Encoder, Harmonic
from folding import each

X = np.arange(1024) / 1024
PHASE_ERROR = 0.05
SHAPES = {
    "both tracks": (Harmonic(3, 0.01, 0.01),),
    "one shape": (Harmonic(3, 0.01, -0.01),),
    "one track": (Harmonic(3, 0.01, 0.0, 0.7),),
    "several": (
        Harmonic(2, 0.004, 0.006, 0.4, 1.1),
        Harmonic(3, 0.005, 0.01),
        Harmonic(5, 0.003, 0.002, -1.0),
    ),
}


def encoder(shape: str, path: AnalogPath) -> Encoder:
    return Encoder(phase_error_rad=PHASE_ERROR, cosine_amplitude=0.98, harmonics=SHAPES[shape], path=path)


def conditioned(shape: str, cosine_delay_s: float) -> Conditioning:
    """By the fundamental; gains and phase error as a fit leaves them, a little off."""
    used = Conditioning(
        cosine_gain=1.0 / 0.975, phase_error_rad=PHASE_ERROR + 0.004, cosine_delay_s=cosine_delay_s
    )
    return with_track_harmonics(used, np.array(encoder(shape, AnalogPath()).tracks(X)))


def angle(s: np.ndarray, c: np.ndarray) -> np.ndarray:
    return np.unwrap(np.arctan2(s, c)) / (2.0 * np.pi)


@each("shape", list(SHAPES))
@each("hertz", [2500.0, 41_667.0, -83_333.0, 125_000.0])
@each(
    "path",
    [
        AnalogPath(sine_corner_hz=125e3, cosine_corner_hz=125e3),
        AnalogPath(sine_corner_hz=125e3, cosine_corner_hz=122.5e3),
        AnalogPath(cosine_delay_s=1e-6),
        AnalogPath(sine_corner_hz=250e3, cosine_corner_hz=255e3, cosine_delay_s=-1e-7),
    ],
)
def test_the_error_of_the_phase_is_the_one_predicted(shape: str, hertz: float, path: AnalogPath) -> None:
    """The tracks of the simulation at speed, conditioned as the chain does, against those at standstill."""
    used = conditioned(shape, path.cosine_delay_s)
    corners = Corners(path.sine_corner_hz, path.cosine_corner_hz)
    front = FrontEnd(used, corners)
    front.use_interval(1.0)
    offset_s, gain_s, offset_c, factor, skew = front.coefficients(hertz)
    lag = hertz * path.lag_s(hertz)
    sine, cosine = encoder(shape, path).tracks(X + lag, hertz)
    s = (sine - offset_s) * gain_s
    fast = angle(s, (cosine - offset_c) * factor - s * skew)
    still = angle(*used.apply(*encoder(shape, AnalogPath()).tracks(X)))
    rows = harmonic_rows(used, corners)
    assert rows is not None
    row = rows.row(hertz)
    moved = np.array([row[int(p * PLACES)][0] + (p * PLACES % 1.0) * row[int(p * PLACES)][1] for p in X])
    away = fast - still
    left = away - moved
    left -= np.round(left.mean())
    left -= left.mean()  # the origin of the fundamental's phase
    assert np.abs(left).max() < 6e-5 + 0.06 * np.ptp(away)
    assert np.sqrt(np.mean(left**2)) < 4e-5 + 0.03 * np.ptp(away)


def test_nothing_to_correct() -> None:
    used = conditioned("several", 0.0)
    assert harmonic_rows(used, NO_LOW_PASS) is None
    assert harmonic_rows(Conditioning(cosine_delay_s=1e-6), Corners(1e5)) is None
    rows = harmonic_rows(used, Corners(1e5))
    assert rows is not None
    assert all(abs(value) < 1e-12 for value, _ in rows.row(0.0)), "a machine at standstill"
    assert rows.row(1e9) is rows.rows[-1]
    assert rows.row(-1e9) is rows.rows[0]
    assert len(rows.rows) == 2 * SPEEDS + 1
    assert harmonic_rows(used, Corners(1e5)) is rows, "made once"


@pytest.mark.parametrize("phase", [0.0, 1e-12, 0.4, 1.0 - 2**-53])
@pytest.mark.parametrize("by", [-0.01, 0.0, 0.01])
def test_a_phase_stays_in_its_cycle(phase: float, by: float) -> None:
    got = corrected(((by, 0.0),) * PLACES, phase)
    assert 0.0 <= got < 1.0
    away = phase - by - got
    assert away == pytest.approx(round(away), abs=1e-12)
