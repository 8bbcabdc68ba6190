"""The simulated machine: it turns in true time, and has a coarse track and a zero pulse."""

from __future__ import annotations

import math
import statistics

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.signal.sample import Sample
from canfb.simulation.encoder import Encoder, ShaftEncoder
from canfb.simulation.motion import Motion, MotionSource, Ramp, Ripple

MOTION = Motion((Ramp(0.1, 0.0), Ramp(1.0, -700.0), Ramp(2.0, 900.0)), (Ripple(20.0, 3.0),))


def source(motion: Motion = MOTION, aperture_jitter_s: float = 0.0, noise_lsb: float = 0.0) -> MotionSource:
    return MotionSource(ShaftEncoder(Encoder(noise_lsb=noise_lsb), 2500, 1, aperture_jitter_s), motion, 1e-3)


@given(st.lists(st.floats(0, 1.0), min_size=1, max_size=30), st.floats(0, 1e5))
def test_the_position_is_a_function_of_true_time_whatever_is_sampled(
    steps: list[float], start: float
) -> None:
    one, now = source(), start
    one.sample_at(now)
    for step in steps:
        now += step
        one.sample_at(now)
        assert one.position_cycles == pytest.approx(2500 * MOTION.revolutions(now - start), abs=1e-5)


def test_the_coarse_track_has_one_cycle_per_revolution() -> None:
    one = source(Motion((), start_rpm=6.0))
    for tenth in range(25):
        sample = one.sample_at(float(tenth))
        angle = 2 * math.pi * tenth / 10
        assert sample.coarse_sine == pytest.approx(1500 * math.sin(angle), abs=1)
        assert sample.coarse_cosine == pytest.approx(1500 * math.cos(angle), abs=1)


@given(st.floats(-3000, 3000).filter(lambda rpm: abs(rpm) > 10), st.floats(1e-4, 0.05))
def test_there_is_a_zero_pulse_in_each_interval_that_passes_a_revolution(
    rpm: float, interval_s: float
) -> None:
    one = source(Motion((), start_rpm=rpm))
    before = None
    for n in range(100):
        at = n * interval_s
        sample, revolutions = one.sample_at(at), rpm / 60 * at
        if before is not None and math.floor(before) != math.floor(revolutions):
            assert sample.zero_pulse is not None
            passed = before + sample.zero_pulse * (revolutions - before)
            assert abs(passed - round(passed)) < 1e-6, "there the position is a whole number of revolutions"
            assert abs(revolutions - round(passed)) <= 1.0 + 1e-6, "the last one, where there are several"
        else:
            assert sample.zero_pulse is None
        before = revolutions


def test_the_place_of_the_zero_pulse_knows_of_the_acceleration() -> None:
    """A revolution after 2 s from standstill, in an interval from 1.9 s to 2.1 s."""
    one = source(Motion((Ramp(10.0, 300.0),)))
    for at in (0.0, 1.9, 2.1):
        sample = one.sample_at(at)
    assert sample.zero_pulse == pytest.approx(0.5)


def test_aperture_jitter_moves_the_instant_by_its_rms_and_four_times_that_at_most() -> None:
    rms_s = 50e-9
    one = source(Motion((), start_rpm=60.0), aperture_jitter_s=rms_s)
    off = []
    for n in range(3000):
        one.sample_at(n * 1e-3)
        off.append(one.position_cycles / 2500 - n * 1e-3)
    assert statistics.pstdev(off[1:]) == pytest.approx(rms_s, rel=0.05)
    assert 2.8 * rms_s < max(map(abs, off)) <= 4.001 * rms_s


def test_for_a_module_that_samples_itself_an_interval_passes_with_each_sample() -> None:
    one = source(Motion((), start_rpm=60.0))
    first, *_ = [one.next() for _ in range(3)]
    assert first == Sample(0, 1500)
    assert one.position_cycles == pytest.approx(5.0)
