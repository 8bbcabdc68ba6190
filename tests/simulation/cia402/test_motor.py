from __future__ import annotations

import contextlib
import math
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.simulation.cia402.plant import Motor, MotorConfig
from folding import each

FREE = {"coulomb_friction_nm": 0.0, "viscous_friction_nm_s": 0.0, "torque_time_constant_s": 0.0}


def motor(command_nm: float = 0.0, speed_rad_s: float = 0.0, **fields: float) -> Motor:
    made = Motor(MotorConfig(**fields))
    made.braked = False
    made.command_nm = command_nm
    made.speed_rad_s = speed_rad_s
    return made


# With 2e-3 Nm s/rad the time constant of the speed is 0.5 s.
@each(
    "viscous, speed, angle",
    [
        (0.0, 210.0, 0.5 * 300.0 * 0.49),
        (1e-13, 210.0, 0.5 * 300.0 * 0.49),
        (2e-3, 150.0 * (1 - math.exp(-1.4)), 150.0 * (0.7 - 0.5 * (1 - math.exp(-1.4)))),
    ],
)
def test_a_constant_torque_accelerates_against_viscous_friction(
    viscous: float, speed: float, angle: float
) -> None:
    one = motor(0.3, **FREE | {"viscous_friction_nm_s": viscous})
    one.run(0.7)
    assert one.speed_rad_s == pytest.approx(speed, rel=1e-9)
    assert one.revolutions == pytest.approx(angle / (2 * math.pi), rel=1e-9)
    assert one.time_s == 0.7


@each("viscous", [0.0, 1e-4])
def test_coulomb_friction_brings_the_shaft_to_rest_and_holds_it(viscous: float) -> None:
    one = motor(0.0, 10.0, **FREE | {"coulomb_friction_nm": 0.01, "viscous_friction_nm_s": viscous})
    one.run(0.9)
    assert one.speed_rad_s > 0
    one.run(0.2)
    assert one.speed_rad_s == 0.0
    rest = one.revolutions
    if not viscous:
        assert rest == pytest.approx(10.0**2 / (2 * 10.0) / (2 * math.pi), rel=1e-9)
    one.command_nm = 0.01
    one.run(1.0)
    assert one.revolutions == rest
    one.command_nm = 0.0100001
    one.run(1.0)
    assert one.revolutions > rest


def test_a_torque_beyond_friction_turns_the_motion_round_within_a_step() -> None:
    one = motor(-0.02, 0.0005, **FREE | {"coulomb_friction_nm": 0.01})
    one.run(1e-4)  # to rest in 16.7 us, then 83.3 us the other way at 10 rad/s^2
    assert one.speed_rad_s == pytest.approx(-10.0 * (1e-4 - 0.0005 / 30.0), rel=1e-6)


def test_the_load_comes_at_its_time_and_the_brake_holds_it() -> None:
    one = motor(**FREE | {"load_torque_nm": 0.3, "load_at_s": 0.5, "brake_torque_nm": 1.0})
    one.run(0.5)
    assert one.revolutions == 0.0
    one.run(0.1)
    assert one.speed_rad_s == pytest.approx(-30.0, rel=1e-6)
    one.braked = True
    one.run(1.0)
    rest = one.revolutions
    one.run(1.0)
    assert (one.speed_rad_s, one.revolutions) == (0.0, rest)


def test_the_torque_follows_its_command_with_the_time_constant() -> None:
    one = motor(0.4, torque_time_constant_s=0.002)
    one.run(0.002)
    assert one.torque_nm == pytest.approx(0.4 * (1 - math.exp(-1)), rel=1e-9)
    free = motor(0.4, **FREE | {"torque_time_constant_s": 0.002})
    free.run(0.02)
    impulse = 0.4 * (0.02 - 0.002 * (1 - math.exp(-10)))
    assert free.speed_rad_s == pytest.approx(impulse / 1e-3, rel=1e-9)


@given(
    st.lists(st.floats(1e-6, 3e-3), min_size=1, max_size=8),
    st.floats(-0.5, 0.5),
    st.floats(-50, 50),
)
def test_how_the_time_is_cut_makes_no_difference_that_matters(
    parts: list[float], command: float, speed: float
) -> None:
    whole, cut = (motor(command, speed) for _ in range(2))
    whole.run(math.fsum(parts))
    for part in parts:
        cut.run(part)
    assert cut.revolutions == pytest.approx(whole.revolutions, abs=5e-7)
    assert cut.time_s == pytest.approx(whole.time_s)


@given(st.floats(-1.0, 1.0), st.floats(-100.0, 100.0))
def test_friction_and_no_torque_never_add_energy(load: float, speed: float) -> None:
    one = motor(0.0, speed)
    for _ in range(20):
        before = abs(one.speed_rad_s)
        one.run(1e-3)
        assert abs(one.speed_rad_s) <= before
        assert one.speed_rad_s * speed >= 0


@each("time_s", [-1e-9, math.nan, math.inf, 0.0])
def test_time_does_not_go_back_and_no_time_changes_nothing(time_s: float) -> None:
    one = motor(0.3, 5.0)
    with contextlib.nullcontext() if time_s == 0.0 else pytest.raises(ValueError, match="duration_s"):
        one.run(time_s)
    assert (one.time_s, one.revolutions, one.torque_nm) == (0.0, 0.0, 0.0)


LOADED = MotorConfig(load_torque_nm=-0.02, load_at_s=2.0, viscous_friction_nm_s=1e-3)


@each("config", [MotorConfig(), LOADED])
@each("speed", [0.0, 3.0, -50.0])
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
