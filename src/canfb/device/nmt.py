"""NMT slave: the state machine (CiA 301, 7.3.2) and the reaction to communication errors."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum

from canfb.device.codes import AbortCode, SdoAbort
from canfb.device.counters import Counters
from canfb.device.entry import Entry


class NmtState(IntEnum):
    """NMT state, with the value that a heartbeat shows."""

    INITIALISING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(IntEnum):
    """Command specifier of the NMT node control protocol (CiA 301, 7.2.8.3.1)."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


COMMUNICATING = frozenset({NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL})
"""The states with SDO, SYNC and EMCY."""

NEXT_STATE = {
    NmtCommand.START: NmtState.OPERATIONAL,
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
}
"""Where a command leads, from any state but INITIALISING."""

COMMUNICATION_ONLY = {NmtCommand.RESET_NODE: False, NmtCommand.RESET_COMMUNICATION: True}

REACTION = {
    0: {NmtState.OPERATIONAL: NmtState.PRE_OPERATIONAL},
    1: {},
    2: {NmtState.OPERATIONAL: NmtState.STOPPED, NmtState.PRE_OPERATIONAL: NmtState.STOPPED},
}
"""What 1029h makes of a communication error, by its value and the present state."""


class Nmt:
    """The NMT state of the node. `changed(old, new, now)` and `reset(communication_only, now)`
    are called for what a command asks.
    """

    def __init__(
        self,
        node_id: int,
        counters: Counters,
        changed: Callable[[NmtState, NmtState, float], None],
        reset: Callable[[bool, float], None],
    ) -> None:
        self.state = NmtState.INITIALISING
        self._node_id = node_id
        self._counters = counters
        self._changed = changed
        self._reset = reset

    def handle(self, data: bytes, now: float) -> None:
        """An NMT command; one for another node, an unknown or a malformed one changes nothing."""
        if len(data) != 2:
            self._counters.malformed_frames += 1
            return
        command, node_id = data
        if node_id not in (0, self._node_id):
            return
        if command in NEXT_STATE:
            self.enter(NEXT_STATE[NmtCommand(command)], now)
        elif command in COMMUNICATION_ONLY:
            self._reset(COMMUNICATION_ONLY[NmtCommand(command)], now)
        else:
            self._counters.malformed_frames += 1

    def enter(self, state: NmtState, now: float) -> None:
        """Go to a state; nothing happens when the node is in it."""
        old = self.state
        if state is not old:
            self.state = state
            self._changed(old, state, now)


class ErrorBehaviour:
    """Object 1029h:01: the NMT state that a communication error leads to."""

    def __init__(self, entry: Entry | None) -> None:
        self._entry = entry
        if entry is not None:
            entry.on_write = _check_behaviour

    def reaction(self, state: NmtState) -> NmtState:
        """The state to enter from `state`; 0 of 1029h, also its absence, is Pre-operational."""
        behaviour = 0 if self._entry is None else self._entry.value
        return REACTION[behaviour].get(state, state)


def _check_behaviour(value: int) -> None:
    if value not in REACTION:
        raise SdoAbort(AbortCode.INVALID_VALUE)
