"""The states of the drive, as a table and under a CiA 402 master that we did not make."""

from typing import Any

import canopen
import pytest
from canopen.profiles.p402 import State402
from drive_bench import DRIVE_ID, UNITS, DriveBench, cruising

from canfb.module.module_config import ModuleConfig
from canfb.simulation.cia402.drive import ServoDrive
from canfb.simulation.cia402.plant import DriveConfig, Motor, Plant
from canfb.simulation.cia402.state_machine import Command, State, StateMachine
from folding import each

# State x command as the figure of the standard has it, restated: the state after it, "." for the same.
COMMANDS = {
    Command.SHUTDOWN: 0x06,
    Command.SWITCH_ON: 0x07,
    Command.ENABLE_OPERATION: 0x0F,
    Command.DISABLE_VOLTAGE: 0x00,
    Command.QUICK_STOP: 0x02,
    Command.FAULT_RESET: 0x80,
    Command.FAIL: None,
    Command.RAMP_DONE: None,
}
CONTROLWORDS = [(command, word) for command, word in COMMANDS.items() if word is not None]
LETTERS = dict(zip("nSROEQrF", State, strict=True))
FIGURE = {
    "n": "......r.",
    "S": "R.....r.",
    "R": ".OESS.r.",
    "O": "R.ESS.r.",
    "E": "RO.SQ.r.",
    "Q": "...S..rS",
    "r": ".......F",
    "F": ".....S..",
}


@each("state, row", FIGURE.items())
def test_each_command_in_each_state(state: str, row: str) -> None:
    for command, after in zip(COMMANDS, row, strict=True):
        machine = StateMachine(LETTERS[state])
        assert machine.go(command) == (after != "."), command
        assert machine.state is LETTERS[state if after == "." else after], command


def test_a_fault_reset_is_a_rising_edge() -> None:
    machine = StateMachine()
    words = [0x80, 0x80, 0x8F, 0x00, 0x80, 0x0F, 0x8F]
    reset, none = Command.FAULT_RESET, Command.NONE
    assert [machine.command(word) for word in words] == [
        reset, none, none, Command.DISABLE_VOLTAGE, reset, Command.ENABLE_OPERATION, reset,
    ]  # fmt: skip


WITHOUT_VOLTAGE = [(Command.DISABLE_VOLTAGE, word) for word in (0x01, 0x04, 0x05, 0x08, 0x0D)]


@each("command, word", CONTROLWORDS + WITHOUT_VOLTAGE)
@each("extra", [0x00, 0x10, 0x40, 0x100, 0x7F00, 0x8000])
def test_bits_of_the_mode_do_not_change_the_command(command: Command, word: int, extra: int) -> None:
    assert StateMachine().command(word | extra) is command


@pytest.mark.parametrize("state", State)
def test_a_master_that_we_did_not_make_reads_the_same_state(state: State) -> None:
    name = state.name.replace("_", " ")
    mask, bits = State402.SW_MASK[name]
    assert state.value & mask == bits
    assert [one for one, (mask, bits) in State402.SW_MASK.items() if state.value & mask == bits] == [name]
    assert state.value & ~0x6F == 0, "bits of the statusword"


CYCLIC = "CYCLIC SYNCHRONOUS POSITION"


@pytest.fixture
def bench() -> DriveBench:
    return DriveBench()


def test_the_modes_are_those_of_6502h_and_other_fault_reactions_are_refused(bench: DriveBench) -> None:
    assert bench.master.is_op_mode_supported(CYCLIC)
    bench.master.op_mode = CYCLIC
    assert bench.master.op_mode == CYCLIC
    assert not bench.master.is_op_mode_supported("PROFILED POSITION")
    for number in (1, 3, 6, 9, -1):
        with pytest.raises(canopen.SdoAbortedError, match="0x06090030"):
            bench.write(0x6060, number)
    for option in (-1, 1, 3):
        with pytest.raises(canopen.SdoAbortedError, match="0x060900"):
            bench.write(0x605E, option)
    assert bench.read(0x6061) == 8
    bench.write(0x6060, 0)
    assert bench.read(0x6061) == 0


def test_each_change_of_state_is_told_at_once(bench: DriveBench) -> None:
    before = len(bench.words(0x180 + DRIVE_ID))
    for controlword in (0x06, 0x07, 0x0F, 0x00):
        bench.control(controlword)
    for state in ("PRE-OPERATIONAL", "OPERATIONAL"):
        bench.master.nmt.state = state
        assert bench.read(0x6041) == (0x0050 if state.startswith("PRE") else 0x0250)
    assert bench.words(0x180 + DRIVE_ID)[before:] == [0x0231, 0x0233, 0x0237, 0x0250, 0x0250]


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
    motor: dict[str, Any] = {"inertia_kg_m2": 2e-4, "rated_torque_nm": 1.5}
    plant = Plant(Motor(DriveConfig(node_id=DRIVE_ID, synchronous_feedback=True, **motor)))
    drive = ServoDrive(plant, ModuleConfig(node_id=0x21, cycles_per_revolution=1024))
    places = {
        (0x1403, 1): 0x1A1,
        (0x1403, 2): 1,
        (0x2100, 5): 2000,
        (0x2110, 5): 511 << 23,
        (0x2110, 7): 0xA1,
        (0x6076, 0): 1500,
        (0x60E6, 1): 1 << 23,
    }
    assert {place: drive.dictionary.entry(*place).default for place in places} == places
    assert {place: drive.dictionary.entry(*place).value for place in places} == places
    alone = ServoDrive(plant)
    assert alone.dictionary.entry(0x1403, 1).value == 0x80000500 + DRIVE_ID
