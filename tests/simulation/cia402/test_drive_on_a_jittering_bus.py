"""The drive with SYNCs that jitter: it holds its loop, and what it misses is speed times jitter."""

from __future__ import annotations

import numpy as np
import pytest
from drive_bench import UNITS, DriveBench

from canfb.simulation.cia402.state_machine import State
from canfb.simulation.sync_producer import SyncTiming

CYCLES = 2500
AMPLITUDE = 0.5  # revolutions, at 1 Hz


def running(jitter_us: float) -> DriveBench:
    bench = DriveBench(operational=False, timing=SyncTiming(sync_jitter_us=jitter_us))
    bench.module_master.sdo[0x1006].raw = 1000
    bench.master.sdo[0x1006].raw = 1000
    bench.operate()
    bench.enable()
    return bench


@pytest.mark.parametrize("jitter_us", [20.0, 100.0, 200.0])
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


def test_the_speed_is_not_that_of_the_jitter() -> None:
    bench = running(100.0)
    speeds, truth = [], []
    for n in range(1500):
        bench.target(round(UNITS * 2.0 * max(0.0, n * 1e-3 - 0.5)))
        bench.cycle()
        speeds.append(bench.drive.feedback.speed)
        truth.append(bench.motor.speed_rad_s / (2 * np.pi))
    assert truth[-1] == pytest.approx(2.0, rel=0.1)
    off = np.array(speeds[1000:]) - np.array(truth[1000:])
    # As if all intervals were equal it would be 10 % and more.
    assert np.abs(off).max() < 0.06
    assert np.abs(off).max() > 1e-4


def test_in_a_pause_of_sync_the_machine_goes_on_turning_and_the_position_is_not_believed() -> None:
    bench = running(0.0)
    for n in range(700):
        bench.target(round(UNITS * 2.0 * n * 1e-3))
        bench.cycle()
    before = bench.motor.revolutions
    bench.bus.run_until(bench.bus.now + 0.5)
    assert bench.state is State.FAULT, "8700h, no SYNC"
    bench.plant.go_on_to(bench.bus.now)
    assert bench.motor.revolutions > before + 0.1
