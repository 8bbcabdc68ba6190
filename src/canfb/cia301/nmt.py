"""The NMT states and commands of CiA 301."""

from __future__ import annotations

from enum import IntEnum


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
