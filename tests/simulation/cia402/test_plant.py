from __future__ import annotations

import math
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.cia301.frame import Frame
from canfb.simulation.cia402.feedback_input import SyncInterval
from canfb.simulation.cia402.plant import Motor, MotorConfig, Plant, PlantSource
from canfb.simulation.encoder import Encoder, ShaftEncoder

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


def test_before_the_first_sync_no_time_passes() -> None:
    one = plant()
    one.go_on_to(100.0)
    one.receive(SYNC, 1000.0)
    assert one.motor.time_s == 0.0


def test_the_time_of_a_sync_is_that_of_its_reception() -> None:
    one = plant()
    one.receive(SYNC._replace(timestamp=5.0), 5.003)
    one.receive(SYNC._replace(timestamp=5.25), 5.4)
    assert one.motor.time_s == pytest.approx(0.25)
    one.receive(SYNC._replace(timestamp=5.1), 5.5)
    assert one.motor.time_s == pytest.approx(0.25), "time does not go back"


def test_other_frames_and_a_remote_frame_move_nothing() -> None:
    one = plant()
    for frame in (SYNC, Frame(0x81, b""), Frame(0x80, b"", True), Frame(0x180, b"")):
        one.receive(frame, 1.0 if frame is SYNC else 2.0)
    assert one.motor.time_s == 0.0
    assert (one.start(0.0), one.tick(0.0), one.deadline()) == ([], [], None)


def test_a_sync_with_a_counter_is_one() -> None:
    one = plant()
    one.receive(Frame(0x80, b"\x01"), 0.0)
    one.receive(Frame(0x80, b"\x02"), 0.001)
    assert one.motor.time_s == pytest.approx(1e-3)


def test_a_torque_acts_from_its_time_on() -> None:
    one = plant(speed=0.0)
    one.receive(SYNC, 1.0)
    one.drive(0.1, True, 1.00025)
    one.receive(SYNC, 1.001)
    assert one.motor.speed_rad_s == pytest.approx(100.0 * 0.75e-3)


def test_a_torque_that_comes_later_than_the_next_sync_should_have_acts_from_there() -> None:
    one = plant(speed=0.0)
    one.receive(SYNC, 1.0)
    one.drive(0.1, True, 1.5)
    one.receive(SYNC, 1.6)
    assert one.motor.speed_rad_s == pytest.approx(100.0 * 0.1)


def test_a_torque_before_the_first_sync_waits_for_it() -> None:
    one = plant(speed=0.0)
    one.drive(0.1, True, 0.5)
    one.receive(SYNC, 1.0)
    assert one.motor.speed_rad_s == 0.0
    one.receive(SYNC, 1.001)
    assert one.motor.speed_rad_s == pytest.approx(0.1)


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


LOADED = MotorConfig(load_torque_nm=-0.02, load_at_s=2.0, viscous_friction_nm_s=1e-3)


@pytest.mark.parametrize("config", [MotorConfig(), LOADED], ids=["friction", "a load that comes"])
@pytest.mark.parametrize("speed", [0.0, 3.0, -50.0])
def test_a_long_pause_in_one_step_is_what_it_is_in_many(config: MotorConfig, speed: float) -> None:
    at_once, often = Motor(config), Motor(config)
    for motor in (at_once, often):
        motor.speed_rad_s, motor.command_nm, motor.braked = speed, 0.03, False
    at_once.run(5.0)
    for _ in range(5000):
        often.run(0.001)
    assert at_once.revolutions == pytest.approx(often.revolutions, rel=1e-7, abs=1e-9)
    assert at_once.speed_rad_s == pytest.approx(often.speed_rad_s, rel=1e-7, abs=1e-9)
    assert at_once.time_s == pytest.approx(5.0)


def test_a_pause_of_a_day_takes_no_time() -> None:
    motor, began = Motor(MotorConfig()), time.process_time()
    motor.run(86_400.0)
    assert motor.time_s == pytest.approx(86_400.0)
    assert time.process_time() - began < 1.0


def test_the_interval_is_measured_without_pauses_and_late_ones() -> None:
    interval = SyncInterval()
    now = 0.0
    for step in [1e-3] * 50 + [0.2] + [1e-3] * 50 + [5e-3, 1e-5, 1e-5, 1e-5] + [1e-3] * 5:
        now += step
        interval.event(now)
    assert interval.seconds == pytest.approx(1e-3, rel=1e-6)


@pytest.mark.parametrize("other", [1e-4, 3e-3, 0.5])
def test_another_rate_is_learnt(other: float) -> None:
    interval = SyncInterval()
    now = 0.0
    for step in [1e-3] * 20 + [other] * 8:
        now += step
        interval.event(now)
    assert interval.seconds == pytest.approx(other)


def test_before_the_second_sync_the_interval_is_not_known() -> None:
    interval = SyncInterval()
    assert interval.seconds == 0.0
    interval.event(7.0)
    interval.event(7.0)
    assert (interval.seconds, interval.last_s) == (0.0, 7.0)
