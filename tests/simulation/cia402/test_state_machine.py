from __future__ import annotations

import pytest
from canopen.profiles.p402 import State402

from canfb.simulation.cia402.state_machine import (
    Command,
    State,
    StateMachine,
    command_of,
)

# State x command as the figure of the standard has it, restated: the state after it, "." for the same.
# Order of the columns: shutdown, switch on, enable operation, disable voltage, quick stop, fault reset.
CONTROLWORDS = {
    Command.SHUTDOWN: 0x06,
    Command.SWITCH_ON: 0x07,
    Command.ENABLE_OPERATION: 0x0F,
    Command.DISABLE_VOLTAGE: 0x00,
    Command.QUICK_STOP: 0x02,
    Command.FAULT_RESET: 0x80,
}
LETTERS = dict(
    zip(
        "nSROEQrF",
        [
            State.NOT_READY_TO_SWITCH_ON,
            State.SWITCH_ON_DISABLED,
            State.READY_TO_SWITCH_ON,
            State.SWITCHED_ON,
            State.OPERATION_ENABLED,
            State.QUICK_STOP_ACTIVE,
            State.FAULT_REACTION_ACTIVE,
            State.FAULT,
        ],
        strict=True,
    )
)
FIGURE = {
    "n": "......",
    "S": "R.....",
    "R": ".OESS.",
    "O": "R.ESS.",
    "E": "RO.SQ.",
    "Q": "...S..",
    "r": "......",
    "F": ".....S",
}
CASES = [
    (LETTERS[state], command, LETTERS[state if after == "." else after])
    for state, row in FIGURE.items()
    for command, after in zip(CONTROLWORDS, row, strict=True)
]

STATE_BITS = 0x6F  # of the statusword


def machine_in(state: State) -> StateMachine:
    machine = StateMachine()
    machine.state = state
    return machine


@pytest.mark.parametrize(("state", "command", "after"), CASES)
def test_each_command_in_each_state(state: State, command: Command, after: State) -> None:
    machine = machine_in(state)
    assert machine.control(CONTROLWORDS[command]) == (state is not after)
    assert machine.state is after


@pytest.mark.parametrize("state", State)
def test_an_error_in_each_state_leads_to_fault_once(state: State) -> None:
    machine = machine_in(state)
    is_fault = state in (State.FAULT, State.FAULT_REACTION_ACTIVE)
    assert machine.fail() == (not is_fault)
    assert machine.state is (state if is_fault else State.FAULT_REACTION_ACTIVE)


@pytest.mark.parametrize("state", State)
def test_the_ends_of_reactions_in_each_state(state: State) -> None:
    machine = machine_in(state)
    assert machine.reaction_done() == (state is State.FAULT_REACTION_ACTIVE)
    assert machine.state is (State.FAULT if state is State.FAULT_REACTION_ACTIVE else state)
    machine = machine_in(state)
    assert machine.quick_stop_done() == (state is State.QUICK_STOP_ACTIVE)
    assert machine.state is (State.SWITCH_ON_DISABLED if state is State.QUICK_STOP_ACTIVE else state)
    machine = machine_in(state)
    assert machine.quick_stop() == (state is State.OPERATION_ENABLED)
    assert machine.state is (State.QUICK_STOP_ACTIVE if state is State.OPERATION_ENABLED else state)


@pytest.mark.parametrize("state", State)
def test_disable_voltage_by_itself_is_the_command(state: State) -> None:
    machine, other = machine_in(state), machine_in(state)
    assert machine.disable_voltage() == other.control(0x00)
    assert machine.state is other.state


def test_power_on_leads_to_switch_on_disabled() -> None:
    machine = StateMachine()
    assert machine.state is State.NOT_READY_TO_SWITCH_ON
    machine.power_on()
    assert machine.state is State.SWITCH_ON_DISABLED


def test_a_fault_reset_is_a_rising_edge() -> None:
    machine = machine_in(State.SWITCH_ON_DISABLED)
    machine.control(0x80)
    machine.state = State.FAULT
    assert not machine.control(0x80)
    assert not machine.control(0x00)
    assert machine.control(0x80)
    assert machine.state is State.SWITCH_ON_DISABLED


def test_a_fault_whose_cause_is_there_is_not_reset_and_needs_another_edge() -> None:
    machine = machine_in(State.FAULT)
    assert not machine.control(0x80, may_reset=False)
    assert not machine.control(0x80)
    machine.control(0x0F)
    assert machine.state is State.FAULT
    assert machine.control(0x80)


def test_with_bit_7_held_no_other_command_is_heard() -> None:
    assert command_of(0x8F, before=0x80) is Command.NONE
    assert command_of(0x8F, before=0x0F) is Command.FAULT_RESET


@pytest.mark.parametrize("extra", [0x10, 0x40, 0x100, 0x7F00, 0x8000])
@pytest.mark.parametrize(("command", "word"), CONTROLWORDS.items())
def test_bits_of_the_mode_do_not_change_the_command(command: Command, word: int, extra: int) -> None:
    assert command_of(word | extra) is command


@pytest.mark.parametrize("word", [0x00, 0x01, 0x04, 0x05, 0x08, 0x0D])
def test_without_voltage_the_other_bits_do_not_matter(word: int) -> None:
    assert command_of(word) is Command.DISABLE_VOLTAGE


@pytest.mark.parametrize("state", State)
def test_a_master_that_we_did_not_make_reads_the_same_state(state: State) -> None:
    name = state.name.replace("_", " ")
    mask, bits = State402.SW_MASK[name]
    assert state.value & mask == bits
    others = [other for other, (mask, bits) in State402.SW_MASK.items() if state.value & mask == bits]
    assert others == [name]
    assert state.value & ~STATE_BITS == 0
