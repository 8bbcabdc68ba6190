"""In which NMT state the recorded module was when its log began."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from enum import Enum

from canfb.cia301.cob import ERROR_CONTROL
from canfb.cia301.frame import Frame
from canfb.cia301.nmt import NmtCommand, NmtState

HEAD_FRAMES = 20_000
"""So many frames from the beginning of a log are asked."""
BOOT_UP = b"\0"


class Begin(Enum):
    """How a replay begins."""

    AUTO = "auto"
    BOOT_UP = "boot-up"
    PRE_OPERATIONAL = "pre-operational"
    OPERATIONAL = "operational"


def found_in(head: Iterable[Frame], node_id: int, own_can_ids: Collection[int]) -> Begin:
    """NMT state by the first frame that shows it.

    A boot-up of the module: it is powered on there. A PDO of its own, or a heartbeat with 05h: it was
    OPERATIONAL. Another heartbeat, or an NMT start: it was not. A log without any of these has no master:
    OPERATIONAL, or the replay would show nothing.
    """
    error_control = ERROR_CONTROL + node_id
    pdos = {can_id for can_id in own_can_ids if 0x180 < can_id < 0x580}
    for can_id, data, rtr, _ in head:
        if rtr:
            continue
        if can_id == error_control and len(data) == 1:
            if data == BOOT_UP:
                return Begin.BOOT_UP
            running = data[0] & 0x7F == NmtState.OPERATIONAL
            return Begin.OPERATIONAL if running else Begin.PRE_OPERATIONAL
        if can_id in pdos:
            return Begin.OPERATIONAL
        if can_id == 0 and data[:1] == bytes([NmtCommand.START]) and data[1:2] in (b"\0", bytes([node_id])):
            return Begin.PRE_OPERATIONAL
    return Begin.OPERATIONAL
