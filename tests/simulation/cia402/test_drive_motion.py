"""How well the loop over the bus holds and follows, also with SYNCs that jitter; bounded on both sides."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from drive_bench import UNITS, DriveBench

from canfb.simulation.cia402.state_machine import State
from canfb.simulation.sync_producer import SyncTiming

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


def test_a_step_of_one_revolution() -> None:
    bench = enabled()
    start = bench.read(0x6064)
    truth = bench.follow([start + UNITS] * 600)
    overshoot = (truth.max() - start - UNITS) / UNITS
    assert overshoot < 1e-4
    settled_ms = last_outside(truth, start + UNITS, UNITS / 1000)
    ideal_ms = 2000 * math.sqrt(2 * math.pi / 500)  # all of the torque, half of the way each
    assert ideal_ms < settled_ms < 1.6 * ideal_ms
    assert 1e-6 < abs(truth[-1] - start - UNITS) < 10


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


def test_a_load_is_held() -> None:
    bench = enabled(load_torque_nm=0.25, load_at_s=0.2, coulomb_friction_nm=0.0)
    bench.follow([0] * 150)
    truth = bench.follow([0] * 850) / CYCLE
    assert -20 < truth.min() < -1, "the load pulls backwards"
    assert abs(truth[-1]) < 0.2
    assert bench.read(0x6077) == pytest.approx(500, abs=10)
    assert bench.read(0x6074) == pytest.approx(500, abs=10)


def test_6064h_is_the_shaft_at_the_sync() -> None:
    bench, speed_rev_s = enabled(), -40.0
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


@pytest.mark.parametrize(("period_s", "cycles"), [(5e-4, 2500), (5e-3, 128)])
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


CYCLES = 2500
AMPLITUDE = 0.5  # revolutions, at 1 Hz


def running(jitter_us: float) -> DriveBench:
    bench = DriveBench(operational=False, timing=SyncTiming(sync_jitter_us=jitter_us))
    bench.module_master.sdo[0x1006].raw = 1000
    bench.master.sdo[0x1006].raw = 1000
    bench.operate()
    bench.enable()
    return bench


@pytest.mark.parametrize("jitter_us", [20.0, 200.0])
def test_it_follows_a_sine_and_its_position_stays_right(jitter_us: float) -> None:
    bench = running(jitter_us)
    errors, apart = [], []
    for demand in AMPLITUDE * (1 - np.cos(2 * np.pi * np.arange(2000) * 1e-3)):
        bench.target(round(UNITS * demand))
        bench.cycle()
        errors.append(bench.shaft_units / UNITS - demand)
        apart.append((bench.drive.feedback.revolutions - bench.shaft_units / UNITS) * CYCLES)
    assert bench.state is State.OPERATION_ENABLED
    assert bench.emergencies() == bench.emergencies(0x20) == []
    assert np.abs(apart).max() < 0.05, "no cycle lost"
    most = 2 * np.pi * AMPLITUDE * jitter_us * 1e-6  # revolutions in the time by which a SYNC is late
    assert 0.3 * most < np.abs(errors[200:]).max() < 3.0 * most + 1.5 / CYCLES
