"""NMT slave: the state machine (CiA 301, 7.3.2) and the reaction to communication errors."""

from __future__ import annotations

from canfb.cia301.nmt import NmtCommand, NmtState
from canfb.device.core import Core
from canfb.device.od.dictionary import Dictionary, refuse_if

# The states with SDO, SYNC and EMCY.
COMMUNICATING = frozenset({NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL})

# Where a command leads, from any state but INITIALISING.
NEXT_STATE = {
    NmtCommand.START: NmtState.OPERATIONAL,
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
}

COMMUNICATION_ONLY = {NmtCommand.RESET_NODE: False, NmtCommand.RESET_COMMUNICATION: True}

# What 1029h makes of a communication error, by its value and the present state.
REACTION = {
    0: {NmtState.OPERATIONAL: NmtState.PRE_OPERATIONAL},
    1: {},
    2: {NmtState.OPERATIONAL: NmtState.STOPPED, NmtState.PRE_OPERATIONAL: NmtState.STOPPED},
}

WAIT_FOR_MASTER = 1 << 2  # Bit 2 of 1F80h: the node does not go to OPERATIONAL by itself.


class Nmt:
    """Obeys the NMT master."""

    def __init__(self, core: Core) -> None:
        self._core = core

    def handle(self, data: bytes, now: float) -> None:
        if len(data) != 2:
            self._core.counters.malformed_frames += 1
            return
        command, node_id = data
        if node_id not in (0, self._core.node_id):
            return
        if command in NEXT_STATE:
            self._core.reactions.enter(NEXT_STATE[NmtCommand(command)], now)
        elif command in COMMUNICATION_ONLY:
            self._core.reactions.reset(COMMUNICATION_ONLY[NmtCommand(command)], now)
        else:
            self._core.counters.malformed_frames += 1


class Startup:
    """Object 1F80h (CiA 302-2): the node goes on to OPERATIONAL by itself unless bit 2 is set.

    `autostart` takes bit 2 out of the default value, so that a stored value comes first.
    """

    def __init__(self, dictionary: Dictionary, *, autostart: bool) -> None:
        self._entry = entry = dictionary.assumed(0x1F80, value=WAIT_FOR_MASTER)
        entry.on_check = refuse_if(lambda value: value & ~WAIT_FOR_MASTER)  # the rest is for masters
        if autostart:
            entry.default = (entry.default or 0) & ~WAIT_FOR_MASTER
            entry.value &= ~WAIT_FOR_MASTER

    @property
    def autostart(self) -> bool:
        return not self._entry.value & WAIT_FOR_MASTER


class ErrorBehaviour:
    """Object 1029h: the NMT state that a communication error leads to."""

    def __init__(self, dictionary: Dictionary) -> None:
        self._entry = dictionary.assumed(0x1029, 1)
        for entry in dictionary:
            if entry.index == 0x1029 and entry.subindex:
                entry.on_check = refuse_if(lambda value: value not in REACTION)

    def reaction(self, state: NmtState) -> NmtState:
        return REACTION.get(self._entry.value, REACTION[0]).get(state, state)
