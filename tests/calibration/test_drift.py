"""How far an encoder is from the table in force, exactly; and tracks that change during a measurement."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Literal

import numpy as np
import pytest
from hypothesis import example, given, strategies as st
from measurements import extreme_encoder, measured, paper_motion, random_encoder, true_phases, wandering

from canfb import CalibrationError, CorrectionTable, calibrate_from_motion, calibrate_from_zero_crossings
from canfb.calibration.over_speeds import TracksAtSpeed, calibrate_over_speeds
from canfb.calibration.result import Calibration, Reason, drift
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.phase import FloatArray, raw_phases
from canfb.simulation.encoder import Encoder, Harmonic


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    """Some measurement, to put tables and tracks into."""
    return calibrate_from_motion(*measured(1, 300.0, 6.0)[1:])


def table_with(size: float, order: int, shift: float = 0.0, n: int = 1024, constant: float = 0.0):
    x = np.arange(n) / n
    return CorrectionTable(x + constant + size * np.sin(2.0 * np.pi * (order * x + shift)))


def of_encoder(calibration: Calibration, encoder: Encoder, conditioning: Conditioning, n: int = 1024):
    """What a perfect measurement of this encoder gives."""
    tracks = np.array(encoder.tracks(np.arange(1024) / 1024))
    phases = true_phases(encoder, n, conditioning)
    phases -= np.rint(phases[0])
    return replace(calibration, table=CorrectionTable(phases), conditioning=conditioning, tracks=tracks)


conditionings = st.builds(
    Conditioning,
    st.floats(-80.0, 80.0),
    st.floats(-80.0, 80.0),
    st.floats(0.9, 1.1),
    st.floats(0.9, 1.1),
    st.floats(-0.1, 0.1),
)


@given(*[st.integers(16, 4096)] * 2, st.floats(1e-4, 0.02), st.floats(0.0, 1.0), st.floats(-0.2, 0.2))
@example(first=16, second=16, size=0.015625, shift=0.5, constant=0.1)
def test_it_is_exact_between_entries_too(calibration, first, second, size, shift, constant) -> None:
    """Against brute force at very many places, weighed by the way; a constant is no drift."""
    fresh = replace(calibration, table=table_with(size, 2, n=first))
    active = table_with(0.7 * size, 3, shift, n=second, constant=constant)
    raw = np.arange(1 << 18) / (1 << 18)
    phase = fresh.table(raw)
    off = (active(raw) - phase + 0.5) % 1.0 - 0.5
    way = (np.roll(phase, -1) - phase + 0.5) % 1.0 - 0.5
    off -= np.average(off, weights=way)
    found = drift(fresh, active, fresh.conditioning)
    assert found.rms == pytest.approx(np.sqrt(np.average(off**2, weights=way)), rel=1e-3, abs=1e-7)
    assert found.peak == pytest.approx(np.abs(off).max(), rel=1e-3, abs=1e-6)


@given(st.integers(0, 1 << 30), conditionings, conditionings, st.integers(256, 4096))
def test_the_same_encoder_has_no_drift_whatever_the_conditioning(calibration, seed, active, fresh, n) -> None:
    encoder = random_encoder(np.random.default_rng(seed), 0.0)
    table = of_encoder(calibration, encoder, active, n).table
    found = drift(of_encoder(calibration, encoder, fresh), table, active)
    assert found.peak < 3e-5 * (1024 / min(n, 1024)) ** 2


@given(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05))
def test_an_offset_of_the_tracks_moves_the_position_as_theory_says(calibration, sine, cosine) -> None:
    """Offsets a, b turn the phase by (a cos x - b sin x) / 2 pi in first order."""
    old, new = Encoder(), Encoder(sine_offset=sine, cosine_offset=cosine)
    fresh = of_encoder(calibration, new, Conditioning(1500.0 * sine, 1500.0 * cosine))
    found = drift(fresh, of_encoder(calibration, old, IDENTITY).table, IDENTITY)
    size = np.hypot(sine, cosine)
    assert found.rms == pytest.approx(size / (2.0 * np.pi) / np.sqrt(2.0), rel=0.6 * size, abs=1e-5)


def test_a_turned_direction_is_as_far_off_as_can_be(calibration: Calibration) -> None:
    with pytest.raises(ValueError, match="pass the whole calibration"):
        drift(calibration, calibration.table.made_for(Conditioning(1.0)))
    found = drift(calibration, calibration.table, Conditioning(sine_gain=-1.0))
    assert found.peak > 0.45
    assert found.rms > 0.2


def test_a_conditioning_that_puts_zero_into_the_middle_of_the_tracks(calibration: Calibration) -> None:
    far = Conditioning(
        sine_offset_counts=float(calibration.tracks[0, 7]),
        cosine_offset_counts=float(calibration.tracks[1, 7]),
    )
    assert drift(calibration, None, far).peak >= 0.25


@cache
def commissioned(make: Callable[..., Encoder]) -> tuple[Encoder, Calibration]:
    encoder, sine, cosine = measured(3, 300.0, 8.0, make)
    return encoder, calibrate_from_motion(sine, cosine, "fit")


@pytest.mark.parametrize("make", [random_encoder, extreme_encoder])
@pytest.mark.parametrize("conditioning", [None, "fit"])
def test_measurements_of_one_encoder_differ_by_their_uncertainty(
    make: Callable[..., Encoder], conditioning: Literal["fit"] | None
) -> None:
    rng = np.random.default_rng(3)
    encoder, first = commissioned(make)
    slow = calibrate_from_zero_crossings(*encoder.sample(paper_motion(rng, 2.0), rng), conditioning)
    for again in (
        calibrate_from_motion(*encoder.sample(wandering(900.0, rng, 8.0), rng), conditioning),
        slow,
    ):
        found = drift(again, first.table, first.conditioning)
        uncertainty = np.hypot(first.uncertainty_rms, again.uncertainty_rms)
        assert 1e-7 < found.rms < 3.0 * uncertainty
        assert found.peak < 10.0 * uncertainty


Changed = Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
NOISE_COUNTS = 0.5


FIXED = Encoder(
    sine_offset=0.02, cosine_offset=-0.01, cosine_amplitude=1.04, phase_error_rad=-0.04,
    harmonics=(Harmonic(3, 0.01, 0.01),), noise_lsb=NOISE_COUNTS,
)  # fmt: skip


def tracks(position: FloatArray, seed: int) -> tuple[FloatArray, FloatArray]:
    sine, cosine = FIXED.sample(position, np.random.default_rng(seed))
    return sine.astype(float), cosine.astype(float)


SAMPLES = np.arange(9000.0)
ANY_MOTION = np.cumsum(np.minimum(SAMPLES * 0.002, 1.37) * (1.0 + 0.01 * np.sin(SAMPLES / 230.0)))
METHODS = {calibrate_from_motion: ANY_MOTION, calibrate_from_zero_crossings: 0.0173 * SAMPLES}
CHANGES: dict[str, Changed] = {
    "drift of 2 counts": lambda s, c, u: (s + 2.0 * u, c),
    "drift of 2 %": lambda s, c, u: (s + 30.0 * u, c),
    "gain drifts by 3 %": lambda s, c, u: (s * (1.0 + 0.03 * u), c),
    "jump at half time": lambda s, c, u: (s, c + 100.0 * (u > 0.5)),
    "jump in a short measurement": lambda s, c, u: (s[:5000] + 300.0 * (u[:5000] > 0.3), c[:5000]),
    "jump near the end": lambda s, c, u: (s, c + 20.0 * (u > 0.9)),
    "both larger near the end": lambda s, c, u: (s * (1.0 + 0.2 * (u > 0.95)), c * (1.0 + 0.2 * (u > 0.95))),
    "gain at the very end": lambda s, c, u: (s * (1.0 + 0.12 * (u > 0.98)), c),
    "a little gain near the end": lambda s, c, u: (s * (1.0 + 0.003 * (u > 0.97)), c),
    "offset grows near the end": lambda s, c, u: (s + 15.0 * np.maximum(0.0, 20.0 * u - 19.0), c),
    "exchanged": lambda s, c, u: (np.where(u > 0.5, c, s), np.where(u > 0.5, s, c)),
    "inverted": lambda s, c, u: (np.where(u > 0.4, -s, s), c),
}


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.__name__)
@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_no_accuracy_is_stated_that_the_end_of_the_measurement_contradicts(
    method: Callable[..., Calibration], change: Changed
) -> None:
    sine, cosine = change(*tracks(METHODS[method], 1), SAMPLES / len(SAMPLES))
    found, reason = None, ""
    try:
        found = method(np.round(sine), np.round(cosine), "fit")
    except CalibrationError as error:
        reason = error.reason
    if found is None:
        assert reason == Reason.CHANGED
        return
    position = np.arange(4096) / 4096
    later = change(*tracks(position, 7), np.ones(4096))
    raw = raw_phases(*found.conditioning.apply(*later))
    off = (found.table(raw) - position + 0.25) % 1.0
    noise = 6.0 * NOISE_COUNTS / FIXED.amplitude_counts / (2.0 * np.pi)
    assert np.abs(off - np.median(off)).max() < found.uncertainty_peak + noise


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.__name__)
@pytest.mark.parametrize("runout", [0.0, 0.05])
def test_steady_tracks_do_not_change(method: Callable[..., Calibration], runout: float) -> None:
    amplitude = 1.0 + runout * np.sin(METHODS[method] / 3.0)  # over a revolution of 19 cycles
    found = method(*(amplitude * track for track in tracks(METHODS[method], 1)), "fit")
    assert found.change_rms == 0.0
    assert found.uncertainty_peak < 2e-4


def test_the_larger_figure_is_stated_for_a_small_drift() -> None:
    sine, cosine = tracks(ANY_MOTION, 1)
    found = calibrate_from_motion(sine + 5.0 * SAMPLES / len(SAMPLES), cosine, "fit")
    # 5 counts turn the phase by 5 / 1500 rad at the most; the first and last of nine parts see 8/9 of it.
    assert found.change_rms == pytest.approx(8 / 9 * 5 / 1500 / 2 / np.pi / np.sqrt(2), rel=0.15)
    assert found.uncertainty_rms == found.change_rms
    assert found.cramer_rao_ratio is not None
    assert found.cramer_rao_ratio > 10.0


def test_tracks_that_change_from_one_speed_to_the_next_are_refused() -> None:
    measured = []
    for number, per_sample in enumerate((0.0317, 0.2371, 0.4123)):
        sine, cosine = tracks(per_sample * np.arange(6000.0), number)
        measured.append(TracksAtSpeed(sine + 70.0 * (number == 2), cosine, 1000.0, 1000.0 * per_sample))
    with pytest.raises(CalibrationError, match="tables of the speeds differ") as caught:
        calibrate_over_speeds(measured)
    assert caught.value.reason == Reason.CHANGED
