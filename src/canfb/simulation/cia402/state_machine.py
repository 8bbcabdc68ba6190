"""The power drive state machine of CiA 402 (IEC 61800-7-201, finite state automaton) as a table."""

from __future__ import annotations

from enum import Enum, IntFlag


class State(Enum):
    """A state; its value is bits 0 to 3, 5 and 6 of the statusword 6041h."""

    NOT_READY_TO_SWITCH_ON = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08


class Command(Enum):
    """Commands of the controlword 6040h, and internal events."""

    SHUTDOWN = "shutdown"
    SWITCH_ON = "switch on"  # in Operation enabled: disable operation
    ENABLE_OPERATION = "enable operation"
    DISABLE_VOLTAGE = "disable voltage"
    QUICK_STOP = "quick stop"
    FAULT_RESET = "fault reset"
    FAIL = "an error"
    RAMP_DONE = "the ramp of a quick stop or of the reaction to a fault is over"
    NONE = "none"


class Status(IntFlag):
    """Bits of the statusword 6041h that do not encode the state."""

    VOLTAGE_ENABLED = 0x0010
    REMOTE = 0x0200
    INTERNAL_LIMIT = 0x0800
    FOLLOWS_TARGET = 0x1000
    FOLLOWING_ERROR = 0x2000


class Control(IntFlag):
    """Bits of the controlword 6040h."""

    SWITCH_ON = 0x0001
    ENABLE_VOLTAGE = 0x0002
    QUICK_STOP = 0x0004  # 0 requests a quick stop
    ENABLE_OPERATION = 0x0008
    FAULT_RESET = 0x0080


# States in which the motor may have torque.
POWERED = frozenset({State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE})

# States in which an error of the feedback is a fault; in the others the axis is off or in fault already.
SWITCHED_ON = frozenset({State.SWITCHED_ON, State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE})

# The transitions with their numbers in the standard; any other command has no effect.
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
    (State.QUICK_STOP_ACTIVE, Command.RAMP_DONE): State.SWITCH_ON_DISABLED,  # 12
    **{(state, Command.FAIL): State.FAULT_REACTION_ACTIVE for state in State},  # 13, except the next
    (State.FAULT, Command.FAIL): State.FAULT,
    (State.FAULT_REACTION_ACTIVE, Command.RAMP_DONE): State.FAULT,  # 14
    (State.FAULT, Command.FAULT_RESET): State.SWITCH_ON_DISABLED,  # 15, when the error is gone
}


# The first of these bits that is 0 in a controlword determines the command.
COMMANDS = {
    Control.ENABLE_VOLTAGE: Command.DISABLE_VOLTAGE,
    Control.QUICK_STOP: Command.QUICK_STOP,
    Control.SWITCH_ON: Command.SHUTDOWN,
    Control.ENABLE_OPERATION: Command.SWITCH_ON,
}


class StateMachine:
    """The state of the drive, and the last controlword, to detect the edge of a fault reset."""

    def __init__(self, state: State = State.NOT_READY_TO_SWITCH_ON) -> None:
        self.state = state
        self._controlword = 0

    def command(self, controlword: int) -> Command:
        """The command of a controlword; a fault reset is a rising edge of bit 7."""
        before, self._controlword = self._controlword, controlword
        if controlword & Control.FAULT_RESET:
            return Command.NONE if before & Control.FAULT_RESET else Command.FAULT_RESET
        missing = (command for bit, command in COMMANDS.items() if not controlword & bit)
        return next(missing, Command.ENABLE_OPERATION)

    def go(self, command: Command) -> bool:
        before, self.state = self.state, TRANSITIONS.get((self.state, command), self.state)
        return self.state is not before
