"""The NMT state of a node, and whether it was restarted meanwhile: what 700h + id says of it.

No object of CiA 301 holds the NMT state. It is in the heartbeat, and in the response to node guarding, which
only nodes without a heartbeat give. The boot-up, one byte 00h, is the sign of a reset.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from canfb.cia301 import cob
from canfb.cia301.nmt import NmtState
from canfb.commissioning.access import CommissioningError, NodeAccess

HEARTBEAT_TIME, GUARD_TIME = (0x1017, 0), (0x100C, 0)
LATE = 1.5  # periods within which a heartbeat, or a response to another master, is heard
ANSWER_S = 0.1
ASKED = 3  # times, as a remote frame may be lost
STEP_S = 0.005


def state_in(data: bytes) -> NmtState | None:
    """The state in a frame with the CAN-ID 700h + id; None if there is none in it.

    A boot-up is followed by PRE-OPERATIONAL. Bit 7 is the toggle bit of node guarding.
    """
    if len(data) != 1:
        return None
    value = data[0] & 0x7F
    if not value:
        return NmtState.PRE_OPERATIONAL
    return next((state for state in NmtState if state == value), None)


def nmt_state(node: NodeAccess) -> NmtState:
    """The NMT state of a node that answers SDO.

    Waits for the heartbeat (1017h), or for a response to the master that guards the node (100Ch), and asks
    by a remote frame where neither is heard. CommissioningError if the state is not known then.
    """
    heartbeat_s = node.integer(*HEARTBEAT_TIME, "H") / 1000
    with _hearing(node) as heard:
        if heartbeat_s:
            _wait_for(node, heard, LATE * heartbeat_s)
        else:
            _wait_for(node, heard, LATE * node.integer(*GUARD_TIME, "H") / 1000)
            for _ in range(ASKED):
                if not heard:
                    node.master.request(cob.ERROR_CONTROL + node.node_id)
                    _wait_for(node, heard, ANSWER_S)
    states = [state for data in heard if (state := state_in(data)) is not None]
    if states:
        return states[-1]
    raise CommissioningError(
        f"{node.name}: its NMT state is not known: neither a heartbeat nor a response to node guarding "
        f"({cob.ERROR_CONTROL + node.node_id:03X}h) is heard"
    )


@contextlib.contextmanager
def without_restart(node: NodeAccess) -> Iterator[None]:
    """CommissioningError at the end if the node was restarted in here: what was written is gone."""
    with _hearing(node) as heard:
        yield
    if b"\0" in heard:
        raise CommissioningError(f"{node.name} was restarted meanwhile (boot-up heard)")


@contextlib.contextmanager
def _hearing(node: NodeAccess) -> Iterator[list[bytes]]:
    """The data of all frames with the CAN-ID 700h + id from now on."""
    heard: list[bytes] = []

    def hear(can_id: int, data: bytes, at: float) -> None:
        heard.append(bytes(data))

    node.master.subscribe(cob.ERROR_CONTROL + node.node_id, hear)
    try:
        yield heard
    finally:
        node.master.unsubscribe(cob.ERROR_CONTROL + node.node_id, hear)


def _wait_for(node: NodeAccess, heard: list[bytes], within_s: float) -> None:
    end = node.master.now() + within_s
    while not heard and node.master.now() < end:
        node.master.wait(STEP_S)
