from __future__ import annotations

import pytest
from canopen.profiles.p402 import State402

from canfb.simulation.cia402.state_machine import Command, State, StateMachine, command_of
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


@each("command, word", CONTROLWORDS)
@each("extra", [0x00, 0x10, 0x40, 0x100, 0x7F00, 0x8000])
def test_bits_of_the_mode_do_not_change_the_command(command: Command, word: int, extra: int) -> None:
    assert command_of(word | extra) is command


@each("word", [0x00, 0x01, 0x04, 0x05, 0x08, 0x0D])
def test_without_voltage_the_other_bits_do_not_matter(word: int) -> None:
    assert command_of(word) is Command.DISABLE_VOLTAGE


@pytest.mark.parametrize("state", State)
def test_a_master_that_we_did_not_make_reads_the_same_state(state: State) -> None:
    name = state.name.replace("_", " ")
    mask, bits = State402.SW_MASK[name]
    assert state.value & mask == bits
    others = [other for other, (mask, bits) in State402.SW_MASK.items() if state.value & mask == bits]
    assert others == [name]
    assert state.value & ~0x6F == 0, "bits of the statusword"
