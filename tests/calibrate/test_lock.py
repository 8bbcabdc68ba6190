"""A motion that is locked to the samples is seen after a second, and the speed that is named does."""

from __future__ import annotations

import re

import numpy as np
import pytest
from calibrating import command

import canfb
from canfb.calibration.recording import LARGEST_DENOMINATOR, Lock, away_from, find_lock
from canfb.errors import CalibrationError
from canfb.master.samples import TrackSamples
from canfb.simulation.motion import Motion, Ramp, Ripple
from commissioning_kit import CYCLES, RATE_HZ, Bench, random_encoder

RPM_OF_A_CYCLE = 60.0 * RATE_HZ / CYCLES  # per sample
N = 1000


def tracks(cycles_per_sample: float, n: int = N, lost: float = 0.0) -> TrackSamples:
    rng = np.random.default_rng(3)
    sine, cosine = random_encoder(1).sample(0.1 + cycles_per_sample * np.arange(n), rng)
    gone = rng.random(n) < lost
    return TrackSamples.of(np.where(gone, np.nan, sine), np.where(gone, np.nan, cosine), RATE_HZ, "simulated")


def lock_of(samples: TrackSamples) -> Lock | None:
    return find_lock(samples.sine, samples.cosine)


@pytest.mark.parametrize(
    ("speed", "lock"),
    [
        (0.0, Lock(0, 1)),
        (25.0, Lock(0, 1)),
        (-25.0, Lock(0, 1)),
        (12.5, Lock(1, 2)),
        (83 + 1 / 3, Lock(1, 3)),
        (-1 / 3, Lock(2, 3)),
        (2 / 7, Lock(2, 7)),
        (7 / 16, Lock(7, 16)),
        (1.0005, Lock(0, 1)),
        *((speed, None) for speed in (0.382, 25.41, 83.5 + 0.004, 1.003, 0.02, 83.34)),
    ],
)
def test_small_fractions_are_found_and_what_is_far_enough_from_them_is_no_lock(
    speed: float, lock: Lock | None
) -> None:
    assert lock_of(tracks(speed)) == lock
    assert lock_of(tracks(speed, lost=0.03)) == lock


def test_too_few_samples_and_a_dead_track_say_nothing() -> None:
    """A dead track is the wiring, and the measurement says so."""
    dead = tracks(0.382)
    dead.cosine[:] = 0.0
    assert lock_of(tracks(1.0, 255)) is lock_of(dead) is None


def test_the_step_that_is_named_leads_away_from_every_lock() -> None:
    for q in range(1, LARGEST_DENOMINATOR + 1):
        for p in range(q):
            assert lock_of(tracks(p / q + away_from(p / q))) is None


def refused(bench: Bench) -> tuple[CalibrationError, float]:
    """The refusal, and how long it took from the start of the command."""
    began = bench.bus.now
    with pytest.raises(CalibrationError) as error:
        command(bench.master)
    return error.value, bench.bus.now - began


def ramped(rpm: float) -> Motion:
    return Motion((Ramp(0.2, 0.0), Ramp(0.5, rpm)))


@pytest.mark.parametrize(
    ("cycles", "words"), [(25.0, "a whole number"), (12.5, "n + 1/2"), (-12.5, "n + 1/2")]
)
def test_a_lock_is_refused_after_a_second_with_a_speed_that_does(cycles: float, words: str) -> None:
    bench = Bench(motion=ramped(cycles * RPM_OF_A_CYCLE))
    bench.bus.run_until(1.5)
    error, took_s = refused(bench)
    assert took_s < 2.0
    assert error.reason == "locked"
    assert words in str(error)
    named = re.search(r"for example at ([0-9.]+) rpm", str(error))
    assert named is not None
    rpm = float(named[1])
    assert abs(cycles) * RPM_OF_A_CYCLE < rpm < (abs(cycles) + 0.5) * RPM_OF_A_CYCLE
    moving = tracks(rpm / RPM_OF_A_CYCLE, 6000)
    assert canfb.calibrate_from_motion(moving.sine, moving.cosine, "fit", adc_bits=12).accepted


def test_standstill_gets_three_seconds_for_somebody_who_is_about_to_start() -> None:
    bench = Bench(motion=Motion(()))
    error, took_s = refused(bench)
    assert error.reason == "coverage"
    assert 3.0 <= took_s < 4.0
    assert str(error).startswith("the tracks hardly change: the machine is at standstill, or moves")
    assert str(error).endswith("Let it turn 9.17 rpm faster")


def test_a_machine_that_starts_within_them_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    bench = Bench(motion=Motion((Ramp(1.5, 0.0), Ramp(0.5, 61.0)), (Ripple(0.1, 0.3),)))
    words = ("--seconds", "4", "--least-samples", "3000", "--verify", "0.6", "--dry-run")
    assert command(bench.master, *words) == 0
    assert "Accepted." in capsys.readouterr().out
