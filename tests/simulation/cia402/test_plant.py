from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.cia301.frame import Frame
from canfb.simulation.cia402.feedback_input import SyncInterval
from canfb.simulation.cia402.plant import Motor, MotorConfig, Plant, PlantSource
from canfb.simulation.encoder import Encoder, ShaftEncoder
from folding import each

SYNC = Frame(0x80, b"")


def plant(speed: float = 10.0) -> Plant:
    motor = Motor(MotorConfig(coulomb_friction_nm=0, viscous_friction_nm_s=0, torque_time_constant_s=0))
    motor.speed_rad_s = speed
    motor.braked = False
    return Plant(motor)


@given(st.lists(st.floats(0.0, 2.0), min_size=1, max_size=20))
def test_the_machine_turns_in_true_time_however_the_syncs_come(steps: list[float]) -> None:
    one, now = plant(), 5.0
    one.receive(SYNC, now)
    for step in steps:
        now += step
        one.receive(SYNC, now)
    assert one.motor.time_s == pytest.approx(now - 5.0)
    assert one.motor.revolutions == pytest.approx(10.0 * (now - 5.0) / (2 * math.pi))
    assert one.syncs == len(steps) + 1


@each(
    "syncs, passed_s",
    [
        ([], 0.0),
        ([(SYNC._replace(timestamp=5.0), 5.003), (SYNC._replace(timestamp=5.25), 5.4)], 0.25),
        ([(SYNC, 5.0), (SYNC._replace(timestamp=5.25), 5.4), (SYNC._replace(timestamp=5.1), 5.5)], 0.25),
        ([(Frame(0x80, b"\x01"), 0.0), (Frame(0x80, b"\x02"), 0.001)], 1e-3),
        (
            [(SYNC, 1.0), (Frame(0x81, b""), 2.0), (Frame(0x80, b"", True), 2.0), (Frame(0x180, b""), 2.0)],
            0.0,
        ),
    ],
)
def test_time_passes_from_the_first_sync_on_by_when_syncs_are_received(
    syncs: list[tuple[Frame, float]], passed_s: float
) -> None:
    one = plant()
    one.go_on_to(100.0)
    for frame, now in syncs:
        assert one.receive(frame, now) == []
    assert one.motor.time_s == pytest.approx(passed_s)
    assert (one.start(0.0), one.tick(0.0), one.deadline()) == ([], [], None)


@each(
    "first_s, torque_s, last_s, acting_s",
    [(1.0, 1.00025, 1.001, 0.75e-3), (1.0, 1.5, 1.6, 0.1), (1.0, 0.5, 1.001, 1e-3)],
)
def test_a_torque_acts_from_its_time_on_but_not_before_the_first_sync(
    first_s: float, torque_s: float, last_s: float, acting_s: float
) -> None:
    one = plant(speed=0.0)
    steps = [
        (first_s, lambda: one.receive(SYNC, first_s)),
        (torque_s, lambda: one.drive(0.1, True, torque_s)),
        (last_s, lambda: one.receive(SYNC, last_s)),
    ]
    for _, step in sorted(steps, key=lambda pair: pair[0]):
        step()
    assert one.motor.speed_rad_s == pytest.approx(100.0 * acting_s)


def test_without_power_there_is_no_torque_and_the_brake_is_closed() -> None:
    one = plant()
    one.drive(0.3, True, 0.0)
    assert not one.motor.braked
    one.drive(0.3, False, 0.0)
    assert (one.motor.command_nm, one.motor.torque_nm, one.motor.braked) == (0.0, 0.0, True)


def test_the_encoder_is_on_the_shaft() -> None:
    one = plant(speed=0.0)
    source = PlantSource(ShaftEncoder(Encoder(amplitude_counts=1000.0), 2500), one)
    one.motor.revolutions = 3.25 / 2500
    assert source.next()[:2] == (1000, 0)
    assert source.position_cycles == pytest.approx(3.25)


def test_the_encoder_is_sampled_at_the_time_that_is_asked_for_also_at_one_that_is_over() -> None:
    one = plant()
    source = PlantSource(ShaftEncoder(Encoder(), 2500), one)
    one.receive(SYNC, 1.0)
    cycles_per_s = 10.0 / (2 * math.pi) * 2500
    for at, want in ((1.5, 0.5), (2.0, 1.0), (1.9995, 0.9995), (2.5, 1.5)):
        source.sample_at(at)
        assert source.position_cycles == pytest.approx(want * cycles_per_s)


def test_the_zero_pulse_is_where_the_shaft_passes_a_revolution() -> None:
    one = plant(speed=2 * math.pi * 10)
    source = PlantSource(ShaftEncoder(Encoder(), 2500), one)
    one.receive(SYNC, 0.0)
    pulses = {n: pulse for n in range(31) if (pulse := source.sample_at(n * 0.031).zero_pulse) is not None}
    # 0.31 revolutions from sample to sample, a pulse at each whole one
    passed = [turn / 0.31 for turn in range(1, 10)]
    assert pulses == pytest.approx({math.ceil(at): at % 1.0 for at in passed})


@each(
    "steps, seconds",
    [
        ([], 0.0),
        ([0.0], 0.0),
        ([1e-3] * 50 + [0.2] + [1e-3] * 50 + [5e-3, 1e-5, 1e-5, 1e-5] + [1e-3] * 5, 1e-3),
        ([1e-3] * 20 + [1e-4] * 8, 1e-4),
        ([1e-3] * 20 + [3e-3] * 8, 3e-3),
        ([1e-3] * 20 + [0.5] * 8, 0.5),
    ],
)
def test_the_interval_is_measured_without_pauses_and_late_ones(steps: list[float], seconds: float) -> None:
    interval, now = SyncInterval(), 7.0
    interval.event(now)
    for step in steps:
        now += step
        interval.event(now)
    assert interval.seconds == pytest.approx(seconds, rel=1e-6)
    assert interval.last_s == now
