from __future__ import annotations

import math

import pytest

from canfb.device.frame import Frame
from canfb.simulation.cia402.interval import SyncInterval
from canfb.simulation.cia402.motor import Motor, MotorConfig
from canfb.simulation.cia402.plant import Plant, PlantSource
from canfb.simulation.encoder import Encoder

SYNC = Frame(0x80, b"")


def plant(interval_s: float | None = 1e-3, speed: float = 10.0) -> Plant:
    motor = Motor(MotorConfig(coulomb_friction_nm=0, viscous_friction_nm_s=0, torque_time_constant_s=0))
    motor.speed_rad_s = speed
    motor.braked = False
    return Plant(motor, interval_s)


def test_one_interval_passes_from_sync_to_sync_however_late_it_is_heard() -> None:
    one = plant()
    for now in (5.0, 5.001, 5.0035, 5.004, 9.0):
        one.receive(SYNC, now)
    assert one.motor.time_s == pytest.approx(4e-3)
    assert one.motor.revolutions == pytest.approx(10.0 * 4e-3 / (2 * math.pi))
    assert one.syncs == 5


def test_a_measured_interval_is_that_of_the_bus() -> None:
    one = plant(None)
    for count in range(101):
        one.receive(SYNC, 0.004 * count)
    assert one.motor.time_s == pytest.approx(0.4)


def test_other_frames_and_a_remote_frame_move_nothing() -> None:
    one = plant()
    for frame in (SYNC, Frame(0x81, b""), Frame(0x80, b"", True), Frame(0x180, b"")):
        one.receive(frame, 1.0)
    assert one.motor.time_s == 0.0
    assert (one.start(0.0), one.tick(0.0), one.deadline()) == ([], [], None)


def test_a_sync_with_a_counter_is_one() -> None:
    one = plant()
    one.receive(Frame(0x80, b"\x01"), 0.0)
    one.receive(Frame(0x80, b"\x02"), 0.001)
    assert one.motor.time_s == pytest.approx(1e-3)


def test_a_torque_acts_from_its_time_within_the_interval() -> None:
    one = plant(speed=0.0)
    one.receive(SYNC, 1.0)
    one.drive(0.1, True, 1.00025)
    one.receive(SYNC, 1.001)
    assert one.motor.speed_rad_s == pytest.approx(100.0 * 0.75e-3)


def test_a_torque_that_comes_after_the_interval_acts_in_the_next_one() -> None:
    one = plant(speed=0.0)
    one.receive(SYNC, 1.0)
    one.drive(0.1, True, 1.5)
    one.receive(SYNC, 1.6)
    assert one.motor.speed_rad_s == 0.0
    one.receive(SYNC, 1.601)
    assert one.motor.speed_rad_s == pytest.approx(0.1)


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


@pytest.mark.parametrize("interval_s", [0.0, -1.0, math.nan, math.inf])
def test_a_wrong_interval_is_refused(interval_s: float) -> None:
    with pytest.raises(ValueError, match="interval_s"):
        plant(interval_s)


def test_the_encoder_is_on_the_shaft() -> None:
    one = plant()
    source = PlantSource(Encoder(amplitude_counts=1000.0), one, 2500)
    one.motor.revolutions = 3.25 / 2500
    assert source.next()[:2] == (1000, 0)
    assert source.position_cycles == pytest.approx(3.25)


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
