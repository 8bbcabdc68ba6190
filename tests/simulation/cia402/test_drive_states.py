"""The drive under a CiA 402 master that we did not make: states, modes, stops, what goes over the bus."""

from __future__ import annotations

import struct
from collections.abc import Callable

import canopen
import pytest
from drive_bench import DRIVE_ID, SYNC, UNITS, DriveBench, cruising
from hypothesis import given, settings
from hypothesis import strategies as st

from canfb.cia301.frame import Frame
from canfb.simulation.cia402.drive import FeedbackModuleLink, ServoDrive
from canfb.simulation.cia402.plant import Motor, MotorConfig, Plant
from canfb.simulation.cia402.state_machine import State
from folding import each

CYCLIC = "CYCLIC SYNCHRONOUS POSITION"


@pytest.fixture
def bench() -> DriveBench:
    return DriveBench()


def statuswords(bench: DriveBench) -> list[int]:
    return [
        struct.unpack_from("<H", frame.data)[0] for frame in bench.heard if frame.can_id == 0x180 + DRIVE_ID
    ]


def test_the_master_walks_it_through_all_states(bench: DriveBench) -> None:
    master = bench.master
    assert master.state == "SWITCH ON DISABLED"
    for target in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED", "QUICK STOP ACTIVE"):
        master.state = target
        assert master.state == target
    master.state = "SWITCH ON DISABLED"
    assert bench.state is State.SWITCH_ON_DISABLED


def test_the_modes_are_those_of_6502h(bench: DriveBench) -> None:
    assert bench.master.is_op_mode_supported(CYCLIC)
    bench.master.op_mode = CYCLIC
    assert bench.master.op_mode == CYCLIC
    assert not bench.master.is_op_mode_supported("PROFILED POSITION")
    for number in (1, 3, 6, 9, -1):
        with pytest.raises(canopen.SdoAbortedError, match="0x06090030"):
            bench.write(0x6060, number)
    assert bench.read(0x6061) == 8
    bench.write(0x6060, 0)
    assert bench.read(0x6061) == 0


def test_other_fault_reactions_are_refused(bench: DriveBench) -> None:
    for option in (-1, 1, 3):
        with pytest.raises(canopen.SdoAbortedError, match="0x060900"):
            bench.write(0x605E, option)


def test_each_change_of_state_is_told_at_once(bench: DriveBench) -> None:
    before = len(statuswords(bench))
    for controlword in (0x06, 0x07, 0x0F, 0x00):
        bench.control(controlword)
    assert statuswords(bench)[before:] == [0x0231, 0x0233, 0x0237, 0x0250]


def test_entering_operational_tells_the_state_and_leaving_takes_remote_away(bench: DriveBench) -> None:
    before = len(statuswords(bench))
    bench.master.nmt.state = "PRE-OPERATIONAL"
    assert bench.read(0x6041) == 0x0050
    bench.master.nmt.state = "OPERATIONAL"
    assert statuswords(bench)[before:][-1] == 0x0250


def test_the_statusword_is_there_before_any_sync() -> None:
    bench = DriveBench(operational=False)
    assert bench.read(0x6041) == 0x0050
    assert bench.read(0x603F) == 0


def test_enabled_it_holds_the_position_whatever_607ah_says(bench: DriveBench) -> None:
    bench.write(0x607A, 5 * UNITS)
    bench.enable()
    bench.cycle(200)
    assert bench.state is State.OPERATION_ENABLED
    assert abs(bench.shaft_units) < 50
    assert bench.read(0x6041) == 0x1237


def test_before_power_nothing_turns(bench: DriveBench) -> None:
    bench.master.op_mode = CYCLIC
    for controlword in (0x06, 0x07):
        bench.control(controlword)
        for _ in range(50):
            bench.target(UNITS)
            bench.cycle()
    assert bench.state is State.SWITCHED_ON
    assert bench.motor.revolutions == 0.0
    assert bench.motor.braked
    bench.control(0x0F)
    assert not bench.motor.braked


def test_a_quick_stop_is_the_ramp_of_6085h_and_then_the_power_goes() -> None:
    bench = cruising()
    start = bench.motor.revolutions
    bench.control(0x02)
    assert bench.state is State.QUICK_STOP_ACTIVE
    assert bench.read(0x6041) & 0x6F == 0x07
    bench.control(0x0F)
    assert bench.state is State.QUICK_STOP_ACTIVE, "it ends in Switch on disabled"
    bench.cycle(300)
    assert bench.state is State.SWITCH_ON_DISABLED
    # The demand was up to 0.005 revolutions ahead or behind when it began.
    assert bench.motor.revolutions - start == pytest.approx(25 / 120, abs=0.008)
    assert abs(bench.motor.speed_rad_s) < 0.1
    assert bench.motor.braked


def test_disable_operation_takes_the_torque_away() -> None:
    bench = cruising(coulomb_friction_nm=0.0, viscous_friction_nm_s=0.0)
    bench.control(0x07)
    assert (bench.state, bench.motor.command_nm, bench.read(0x6077)) == (State.SWITCHED_ON, 0.0, 0)
    speed = bench.motor.speed_rad_s
    bench.cycle(50)
    assert bench.motor.speed_rad_s == speed


def test_a_change_of_mode_forgets_the_targets() -> None:
    bench = cruising()
    bench.write(0x6060, 0)
    assert bench.read(0x6061) == 0
    bench.cycle(150)
    place = bench.motor.revolutions
    bench.write(0x6060, 8)
    bench.cycle(100)
    assert bench.motor.revolutions == pytest.approx(place, abs=1e-3)


def test_software_limits_end_the_way_and_are_told(bench: DriveBench) -> None:
    bench.write(0x607D, UNITS // 4, 2)
    bench.enable()
    bench.write(0x6065, 0xFFFFFFFF)
    bench.write(0x607A, UNITS)
    bench.cycle(50)
    assert bench.read(0x6041) & 0x0800
    bench.cycle(500)
    assert bench.shaft_units == pytest.approx(UNITS / 4, abs=50)


def test_a_reset_of_the_node_switches_off_and_brings_the_defaults_back() -> None:
    bench = cruising()
    bench.write(0x6085, 12345)
    bench.master.nmt.send_command(0x81)
    assert bench.state is State.SWITCH_ON_DISABLED
    assert bench.motor.command_nm == 0.0
    assert bench.read(0x6085) == 62914560
    assert bench.read(0x1403, 1) == 0x1A0
    assert bench.read(0x603F) == 0


def test_the_parameters_of_a_motor_and_a_module_are_defaults() -> None:
    plant = Plant(Motor(MotorConfig(inertia_kg_m2=2e-4, rated_torque_nm=1.5)))
    link = FeedbackModuleLink(node_id=0x21, increments_per_revolution=4096, total_range=0, synchronous=True)
    drive = ServoDrive(DRIVE_ID, plant, link, serial_number=77)
    places = {
        (0x1018, 4): 77,
        (0x1403, 1): 0x1A1,
        (0x1403, 2): 1,
        (0x2100, 5): 2000,
        (0x2110, 5): 0,
        (0x2110, 7): 0xA1,
        (0x6076, 0): 1500,
        (0x60E6, 1): 4096,
    }
    assert {place: drive.dictionary.entry(*place).default for place in places} == places
    assert {place: drive.dictionary.entry(*place).value for place in places} == places
    alone = ServoDrive(DRIVE_ID, plant)
    assert alone.dictionary.entry(0x1403, 1).value == 0x80000500 + DRIVE_ID


@each(
    "build, field",
    [
        (lambda: FeedbackModuleLink(node_id=0), "node_id"),
        (lambda: FeedbackModuleLink(node_id=128), "node_id"),
        (lambda: FeedbackModuleLink(node_id=32, increments_per_revolution=0), "increments_per_revolution"),
        (lambda: FeedbackModuleLink(node_id=32, total_range=1 << 32), "total_range"),
        (lambda: ServoDrive(48, Plant(Motor(MotorConfig())), serial_number=1 << 32), "serial_number"),
    ],
)
def test_a_module_or_a_number_that_cannot_be_is_refused(build: Callable[[], object], field: str) -> None:
    with pytest.raises(ValueError, match=field):
        build()


IDS = [0x000, 0x080, 0x0A0, 0x100, 0x1A0, 0x230, 0x330, 0x630, 0x720, 0x7E5]


@settings(max_examples=50)
@given(
    st.lists(st.tuples(st.sampled_from(IDS), st.binary(max_size=8), st.booleans()), max_size=60),
    st.booleans(),
)
def test_no_frame_raises(frames: list[tuple[int, bytes, bool]], enabled: bool) -> None:
    drive = ServoDrive(
        DRIVE_ID, Plant(Motor(MotorConfig())), FeedbackModuleLink(node_id=0x20), autostart=True
    )
    now = 1.0
    drive.start(now)
    if enabled:
        position = Frame(0x1A0, struct.pack("<IHH", 5, 1, 0))
        for frame in (SYNC, position, SYNC, position):
            drive.receive(frame, now := now + 1e-3)
        for controlword in (0x06, 0x07, 0x0F):
            drive.receive(Frame(0x230, struct.pack("<Hb", controlword, 8)), now)
        assert drive.power is State.OPERATION_ENABLED
    for can_id, data, remote in frames:
        now += 1e-3
        drive.receive(Frame(can_id, data, remote), now)
        due = drive.deadline()
        if due is not None and due <= now:
            drive.tick(now)
