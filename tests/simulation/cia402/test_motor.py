from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.simulation.cia402.plant import Motor, MotorConfig

FREE = {"coulomb_friction_nm": 0.0, "viscous_friction_nm_s": 0.0, "torque_time_constant_s": 0.0}


def motor(command_nm: float = 0.0, speed_rad_s: float = 0.0, **fields: float) -> Motor:
    made = Motor(MotorConfig(**fields))
    made.braked = False
    made.command_nm = command_nm
    made.speed_rad_s = speed_rad_s
    return made


def test_a_constant_torque_accelerates_evenly() -> None:
    one = motor(0.3, **FREE)
    one.run(0.5)
    assert one.speed_rad_s == pytest.approx(150.0, rel=1e-12)
    assert one.revolutions == pytest.approx(0.5 * 300.0 * 0.25 / (2 * math.pi), rel=1e-9)
    assert one.time_s == 0.5


def test_viscous_friction_ends_the_acceleration_as_the_exponential_says() -> None:
    one = motor(0.3, **FREE | {"viscous_friction_nm_s": 2e-3})
    one.run(0.7)
    tau = 1e-3 / 2e-3
    assert one.speed_rad_s == pytest.approx(150.0 * (1 - math.exp(-0.7 / tau)), rel=1e-9)
    angle = 150.0 * (0.7 - tau * (1 - math.exp(-0.7 / tau)))
    assert one.revolutions == pytest.approx(angle / (2 * math.pi), rel=1e-9)


def test_almost_no_viscous_friction_is_almost_none() -> None:
    one, none = motor(0.3, **FREE | {"viscous_friction_nm_s": 1e-13}), motor(0.3, **FREE)
    one.run(0.1)
    none.run(0.1)
    assert one.revolutions == pytest.approx(none.revolutions, rel=1e-9)


@pytest.mark.parametrize("viscous", [0.0, 1e-4])
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


def test_the_brake_holds_what_the_load_would_turn() -> None:
    one = motor(**FREE | {"load_torque_nm": 0.3, "brake_torque_nm": 1.0})
    one.braked = True
    one.run(1.0)
    assert one.revolutions == 0.0
    one.braked = False
    one.run(0.1)
    assert one.speed_rad_s == pytest.approx(-30.0, rel=1e-9)


def test_the_load_comes_at_its_time() -> None:
    one = motor(**FREE | {"load_torque_nm": 0.1, "load_at_s": 0.5})
    one.run(0.5)
    assert one.revolutions == 0.0
    one.run(0.1)
    assert one.speed_rad_s == pytest.approx(-10.0, rel=1e-6)


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


@pytest.mark.parametrize("time_s", [-1e-9, math.nan, math.inf])
def test_time_does_not_go_back(time_s: float) -> None:
    with pytest.raises(ValueError, match="duration_s"):
        motor().run(time_s)


def test_no_time_changes_nothing() -> None:
    one = motor(0.3, 5.0)
    one.run(0.0)
    assert (one.time_s, one.revolutions, one.torque_nm) == (0.0, 0.0, 0.0)
