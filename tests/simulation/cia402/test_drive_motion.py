"""How well the loop over the bus holds and follows; each figure is bounded on both sides."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from drive_bench import UNITS, DriveBench

CYCLE = UNITS / 2500
"""Units of the drive in a cycle of the encoder."""
NO_WINDOW = 0xFFFFFFFF


def enabled(**fields: Any) -> DriveBench:
    bench = DriveBench(**fields)
    bench.enable()
    bench.write(0x6065, NO_WINDOW)
    return bench


def last_outside(positions: np.ndarray, target: float, band: float) -> int:
    """Samples until the position stays within the band."""
    outside = np.nonzero(np.abs(positions - target) > band)[0]
    return int(outside[-1]) + 1 if len(outside) else 0


@pytest.mark.parametrize("synchronous", [False, True])
def test_a_step_of_one_revolution(synchronous: bool) -> None:
    bench = enabled(synchronous=synchronous)
    start = bench.read(0x6064)
    truth = bench.follow([start + UNITS] * 600)
    overshoot = (truth.max() - start - UNITS) / UNITS
    assert overshoot < 1e-4
    settled_ms = last_outside(truth, start + UNITS, UNITS / 1000)
    ideal_ms = 2000 * math.sqrt(2 * math.pi / 500)  # all of the torque, half of the way each
    assert ideal_ms < settled_ms < 1.6 * ideal_ms
    assert 1e-6 < abs(truth[-1] - start - UNITS) < 10


@pytest.mark.parametrize("size", [-3000, 300, 3000])
def test_a_small_step_overshoots_little(size: int) -> None:
    bench = enabled(coulomb_friction_nm=0.0)
    start = bench.read(0x6064)
    truth = (bench.follow([start + size] * 400) - start) / size
    assert truth.max() < 1.06
    assert 10 < int(np.argmax(truth > 0.9)) < 80
    assert abs(truth[-1] - 1) < 0.02


# The friction reverses with the motion, which is most of the error.
SINES: dict[str, tuple[dict[str, Any], tuple[float, float], tuple[float, float]]] = {
    "as delivered": ({}, (0.05, 0.25), (0.2, 0.8)),
    "one period later": ({"synchronous": True}, (0.05, 0.25), (0.2, 0.8)),
    "without friction": (
        {"coulomb_friction_nm": 0.0, "viscous_friction_nm_s": 0.0},
        (0.002, 0.05),
        (0.005, 0.1),
    ),
}


@pytest.mark.parametrize("case", SINES)
def test_a_sine_is_followed(case: str) -> None:
    """Half a revolution at 1 Hz: up to 20 rad/s^2."""
    fields, rms, peak = SINES[case]
    bench = enabled(**fields)
    times = np.arange(3000) * 1e-3
    targets = bench.read(0x6064) + np.round(0.5 * UNITS * (1 - np.cos(2 * np.pi * times)))
    error = (targets - bench.follow(targets))[1000:] / CYCLE
    assert rms[0] < np.sqrt(np.mean(error**2)) < rms[1]
    assert peak[0] < np.abs(error).max() < peak[1]


def test_at_standstill_the_noise_of_the_encoder_is_all_that_moves() -> None:
    bench = enabled(coulomb_friction_nm=0.0, viscous_friction_nm_s=0.0, noise_lsb=2.0)
    bench.cycle(300)
    start = bench.read(0x6064)
    jitter = (bench.follow([start] * 2000) - start) / CYCLE
    assert 1e-6 < np.std(jitter) < 1e-3
    assert 1e-5 < np.ptp(jitter) < 5e-3
    shown = []
    for _ in range(500):
        bench.cycle()
        shown.append(bench.drive.feedback.position / 8192)
    assert 1e-5 < np.std(shown) < 2e-3, "cycles, of the module"


def test_friction_holds_the_shaft_still() -> None:
    bench = enabled()
    bench.follow([1000] * 500)
    place = bench.motor.revolutions
    bench.follow([1000] * 500)
    assert bench.motor.revolutions == pytest.approx(place, abs=1e-7)


def test_a_load_is_held() -> None:
    bench = enabled(load_torque_nm=0.25, load_at_s=0.2, coulomb_friction_nm=0.0)
    bench.follow([0] * 150)
    truth = bench.follow([0] * 850) / CYCLE
    assert -20 < truth.min() < -1, "the load pulls backwards"
    assert abs(truth[-1]) < 0.2
    assert bench.read(0x6077) == pytest.approx(500, abs=10)
    assert bench.read(0x6074) == pytest.approx(500, abs=10)


@pytest.mark.parametrize("speed_rev_s", [-40.0, 40.0])
def test_6064h_is_the_shaft_at_the_sync(speed_rev_s: float) -> None:
    bench = enabled()
    place = float(bench.read(0x6064))
    for count in range(1200):
        place += math.copysign(min(count * 0.05, abs(speed_rev_s)), speed_rev_s) * UNITS * 1e-3
        bench.target(round(place))
        truth = bench.shaft_units
        bench.cycle()
        truth, shown = bench.shaft_units, bench.read(0x6064)
        assert abs(shown - truth) < 0.02 * CYCLE
    assert bench.read(0x606C) / UNITS == pytest.approx(speed_rev_s, rel=1e-3)
    assert bench.read(0x6063) == bench.drive.feedback.position
    assert bench.read(0x6062) - bench.read(0x6064) == pytest.approx(bench.read(0x60F4), abs=2)


def test_the_way_goes_on_where_the_position_of_the_module_wraps() -> None:
    """From 0 to -2 revolutions and back: the module's position wraps, the drive's does not."""
    bench = enabled()
    raw = [bench.module.dictionary.entry(0x6004).value]
    for target in (-2 * UNITS, UNITS):
        bench.follow([target] * 1500)
        assert bench.read(0x6064) == pytest.approx(target, abs=20)
        assert bench.shaft_units == pytest.approx(target, abs=20)
        raw.append(bench.module.dictionary.entry(0x6004).value)
    assert raw[1] > 4_200_000_000
    assert raw[2] < 30_000_000


def test_the_way_goes_on_where_6064h_wraps() -> None:
    """A coarse drive unit is not needed: 2048 revolutions are the end of INTEGER32, not of the way."""
    bench = DriveBench()
    bench.write(0x608F, (1 << 31) // 3, 1)  # 3 revolutions to the end of the positive numbers
    bench.enable()
    bench.write(0x6065, NO_WINDOW)
    for count in range(1, 5):
        bench.follow([(count * (1 << 31) // 3 + (1 << 31)) % (1 << 32) - (1 << 31)] * 1200)
        assert bench.motor.revolutions == pytest.approx(count, abs=1e-3)


def test_a_target_every_few_syncs_is_joined_by_lines() -> None:
    bench = enabled(coulomb_friction_nm=0.0)
    bench.write(0x60C2, 10, 1)
    place = bench.read(0x6064)
    speeds = []
    for count in range(1000):
        if count % 10 == 0:
            place += min(count // 10, 50) * UNITS // 5000
            bench.target(place)
        bench.cycle()
        speeds.append(bench.motor.speed_rad_s / 6.283185)
    assert speeds[-1] == pytest.approx(1.0, rel=0.01)
    assert np.ptp(speeds[-200:]) < 0.05


@pytest.mark.parametrize(("period_s", "cycles"), [(5e-4, 2500), (2e-3, 512), (5e-3, 128)])
def test_the_gains_suit_any_rate_of_sync(period_s: float, cycles: int) -> None:
    bench = enabled(period_s=period_s, cycles_per_revolution=cycles)
    times = np.minimum(np.arange(round(3 / period_s)) * period_s, 1.0)
    bench.follow(np.round(UNITS * (1 - np.cos(np.pi * times)) / 2))
    assert bench.read(0x2101, 1) == pytest.approx(period_s, rel=1e-3)
    assert bench.shaft_units == pytest.approx(UNITS, abs=200)


def test_1006h_is_the_period_where_a_master_has_written_it() -> None:
    bench = DriveBench()
    bench.write(0x1006, 1010)
    bench.cycle(2)
    assert bench.read(0x2101, 1) == pytest.approx(1.01e-3, rel=1e-6)


@pytest.mark.parametrize(("synchronous", "dead_us"), [(False, 0), (True, 1000)])
def test_the_dead_time_is_a_period_if_the_feedback_is_synchronous(synchronous: bool, dead_us: int) -> None:
    bench = enabled(synchronous=synchronous)
    bench.cycle(10)
    assert bench.read(0x2101, 2) == pytest.approx(dead_us, abs=1)


def test_the_position_is_there_in_the_cycle_of_its_sample() -> None:
    """SYNC, ADC counts, position, torque: one after the other within one instant of the bus."""
    bench = enabled()
    bench.cycle(10)
    used = bench.read(0x2111, 2)
    before = len(bench.heard)
    bench.cycle()
    order = [frame.can_id for frame in bench.heard[before:] if frame.can_id in (0x80, 0x190, 0x1A0)]
    assert order == [0x80, 0x190, 0x1A0]
    assert bench.read(0x2111, 2) == used + 1
