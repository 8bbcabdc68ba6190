"""The second act of the demo: what counts the servo's move, what loses it, and what is said of it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from canfb.demo.demo_page import servo, servo_facts
from canfb.demo.servo_act import (
    ACCELERATION_RAD_S2,
    JERK_RAD_S3,
    MOST_RESIDUAL_CYCLES,
    RPM,
    ServoRun,
    servo_move,
)
from canfb.demo.story import Story
from canfb.signal.conditioning import IDENTITY
from canfb.signal.correction import Correction
from canfb.simulation.encoder import Encoder
from canfb.simulation.motion import SCurve
from folding import each
from servo_kit import IDEAL_TABLE, s_curve

SPEED = RPM * 2.0 * math.pi / 60.0


@pytest.fixture(scope="module")
def runs() -> list[ServoRun]:
    return servo_move(Encoder(amplitude_counts=1800.0, noise_lsb=0.5), Correction(IDEAL_TABLE, IDENTITY), 7)


def test_four_samples_count_exactly_and_one_loses_the_move(runs: list[ServoRun]) -> None:
    four, two, one = runs
    assert four.exact
    assert 0.15 < four.largest_residual < MOST_RESIDUAL_CYCLES < four.limit_cycles
    for fewer in (two, one):
        assert not fewer.exact
    assert abs(one.cycles_off) > 1000


def test_every_sample_is_in_the_picture(runs: list[ServoRun]) -> None:
    four, _, one = runs
    assert len(four.residual) == 4 * (len(one.residual) - 1), "the first SYNC has no earlier one"
    assert abs(np.diff(four.time_s) - 0.25e-3).max() < 0.25e-3  # SYNC jitters by 0.1 ms, twice
    assert 0.0 < four.time_s[np.argmax(four.residual)] < 0.055, "it is within the move"
    drawn = servo(Story(servo=runs)).svg()
    assert four.name in drawn
    assert servo(Story()).svg()


def test_what_is_said(runs: list[ServoRun]) -> None:
    facts = servo_facts(Story(servo=runs))
    assert facts[0].words == ("0 to 3000 rpm in 50 ms: 7850 rad/s^2, 785000 rad/s^3",)
    assert facts[1].words[0].startswith("four samples for each SYNC: counted exactly, largest residual 0.")
    assert facts[3].words[0] == f"one sample for each SYNC: lost, {abs(runs[2].cycles_off)} cycles off"
    assert runs[0].figures()["counted_exactly"] is True


def test_a_run_that_was_wrong_once_is_not_exact() -> None:
    assert ServoRun(2, valid=True).exact
    assert not ServoRun(2, valid=True, wrong_and_valid=1).exact
    assert not ServoRun(2, valid=True, cycles_off=-1).exact
    assert not ServoRun(2).exact


def test_the_move_is_limited_in_jerk() -> None:
    times = np.linspace(-0.02, 0.08, 1001)
    move = SCurve(SPEED, ACCELERATION_RAD_S2, JERK_RAD_S3, 0.01)
    assert move.end_s == pytest.approx(0.06, abs=1e-4)
    expected = s_curve(SPEED, ACCELERATION_RAD_S2, JERK_RAD_S3, times - 0.01) / (2.0 * math.pi)
    np.testing.assert_allclose(move.revolutions_at(times), expected, atol=1e-12)
    np.testing.assert_allclose([move.revolutions(float(t)) for t in times], expected, atol=1e-12)


@each(
    "values, message",
    [
        ((0.0, 1.0, 1.0), "speed_rad_s must be positive"),
        ((1.0, math.inf, 1.0), "acceleration_rad_s2 must be positive"),
        ((1.0, 1.0, -1.0), "jerk_rad_s3 must be positive"),
        ((1.0, 100.0, 100.0), "speed_rad_s is too low to reach 100"),
    ],
)
def test_a_move_that_cannot_be(values: tuple[float, float, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SCurve(*values)
