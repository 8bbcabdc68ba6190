"""The power drive state machine of CiA 402 (IEC 61800-7-201, finite state automaton) as a table."""

from __future__ import annotations

from enum import Enum, IntFlag


class State(Enum):
    """A state; its value are the bits 0 to 3, 5 and 6 of the statusword 6041h that report it."""

    NOT_READY_TO_SWITCH_ON = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08


class Command(Enum):
    """What a controlword 6040h asks for."""

    SHUTDOWN = "shutdown"
    SWITCH_ON = "switch on"  # in Operation enabled: disable operation
    ENABLE_OPERATION = "enable operation"
    DISABLE_VOLTAGE = "disable voltage"
    QUICK_STOP = "quick stop"
    FAULT_RESET = "fault reset"
    NONE = "none"


class Status(IntFlag):
    """Bits of the statusword 6041h beside those of the state."""

    VOLTAGE_ENABLED = 0x0010
    WARNING = 0x0080
    REMOTE = 0x0200
    INTERNAL_LIMIT = 0x0800
    FOLLOWS_TARGET = 0x1000
    FOLLOWING_ERROR = 0x2000


class Control(IntFlag):
    """Bits of the controlword 6040h."""

    SWITCH_ON = 0x0001
    ENABLE_VOLTAGE = 0x0002
    QUICK_STOP = 0x0004  # 0 asks for it
    ENABLE_OPERATION = 0x0008
    FAULT_RESET = 0x0080


POWERED = frozenset({State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE})
"""Where the motor may have torque."""

SWITCHED_ON = frozenset({State.SWITCHED_ON, State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE})
"""States in which an error of the supervision is a fault; in the others the axis is off."""

TRANSITIONS: dict[tuple[State, Command], State] = {
    (State.SWITCH_ON_DISABLED, Command.SHUTDOWN): State.READY_TO_SWITCH_ON,  # 2
    (State.READY_TO_SWITCH_ON, Command.SWITCH_ON): State.SWITCHED_ON,  # 3
    (State.READY_TO_SWITCH_ON, Command.ENABLE_OPERATION): State.OPERATION_ENABLED,  # 3 and 4 at once
    (State.READY_TO_SWITCH_ON, Command.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,  # 7
    (State.READY_TO_SWITCH_ON, Command.QUICK_STOP): State.SWITCH_ON_DISABLED,  # 7
    (State.SWITCHED_ON, Command.ENABLE_OPERATION): State.OPERATION_ENABLED,  # 4
    (State.SWITCHED_ON, Command.SHUTDOWN): State.READY_TO_SWITCH_ON,  # 6
    (State.SWITCHED_ON, Command.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,  # 10
    (State.SWITCHED_ON, Command.QUICK_STOP): State.SWITCH_ON_DISABLED,  # 10
    (State.OPERATION_ENABLED, Command.SWITCH_ON): State.SWITCHED_ON,  # 5, disable operation
    (State.OPERATION_ENABLED, Command.SHUTDOWN): State.READY_TO_SWITCH_ON,  # 8
    (State.OPERATION_ENABLED, Command.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,  # 9
    (State.OPERATION_ENABLED, Command.QUICK_STOP): State.QUICK_STOP_ACTIVE,  # 11
    (State.QUICK_STOP_ACTIVE, Command.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,  # 12
    (State.FAULT, Command.FAULT_RESET): State.SWITCH_ON_DISABLED,  # 15, when the error is gone
}
"""The transitions that a controlword causes, with their numbers in the standard; any other does nothing."""


def command_of(controlword: int, before: int = 0) -> Command:
    """What a controlword asks for, given the one ``before`` it: a fault reset is a rising edge of bit 7."""
    if controlword & Control.FAULT_RESET:
        return Command.NONE if before & Control.FAULT_RESET else Command.FAULT_RESET
    if not controlword & Control.ENABLE_VOLTAGE:
        return Command.DISABLE_VOLTAGE
    if not controlword & Control.QUICK_STOP:
        return Command.QUICK_STOP
    if not controlword & Control.SWITCH_ON:
        return Command.SHUTDOWN
    if controlword & Control.ENABLE_OPERATION:
        return Command.ENABLE_OPERATION
    return Command.SWITCH_ON


class StateMachine:
    """The state of the drive. It begins in Not ready to switch on."""

    def __init__(self) -> None:
        self.state = State.NOT_READY_TO_SWITCH_ON
        self._controlword = 0

    def power_on(self) -> None:
        self.state = State.SWITCH_ON_DISABLED
        self._controlword = 0

    def control(self, controlword: int, *, may_reset: bool = True) -> bool:
        """Take a ``controlword`` 0..FFFFh; True if the state has changed. ``may_reset``: no error is left."""
        command = command_of(controlword, self._controlword)
        self._controlword = controlword
        if command is Command.FAULT_RESET and not may_reset:
            return False
        return self._go(TRANSITIONS.get((self.state, command), self.state))

    def fail(self) -> bool:
        """Transition 13, an error; True if the state has changed: not when it is a fault already."""
        if self.state in (State.FAULT, State.FAULT_REACTION_ACTIVE):
            return False
        return self._go(State.FAULT_REACTION_ACTIVE)

    def reaction_done(self) -> bool:
        """Transition 14: the reaction to the fault is over; True if the state has changed."""
        return self.state is State.FAULT_REACTION_ACTIVE and self._go(State.FAULT)

    def quick_stop_done(self) -> bool:
        """Transition 12 by itself: the quick stop is over; True if the state has changed."""
        return self.state is State.QUICK_STOP_ACTIVE and self._go(State.SWITCH_ON_DISABLED)

    def disable_voltage(self) -> bool:
        """Transitions 7, 9, 10 and 12 without a controlword; True if the state has changed."""
        return self._go(TRANSITIONS.get((self.state, Command.DISABLE_VOLTAGE), self.state))

    def quick_stop(self) -> bool:
        """Transition 11 without a controlword; True if the state has changed."""
        return self.state is State.OPERATION_ENABLED and self._go(State.QUICK_STOP_ACTIVE)

    def _go(self, state: State) -> bool:
        changed = state is not self.state
        self.state = state
        return changed
