"""The NMT state of a node, whether it was restarted, and restarting a module.

A module is restarted at standstill only: whole cycles per interval look like a rest. So the machine is
watched before and after the reset.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from canfb import objects as od
from canfb.cia301 import cob
from canfb.cia301.nmt import NmtCommand, NmtState
from canfb.master.access import CommissioningError, Master, NodeAccess, subscribed
from canfb.objects import StatusBit

HEARTBEAT_TIME, GUARD_TIME = od.Multiplexer(0x1017), od.Multiplexer(0x100C)
LATE = 1.5  # periods within which a heartbeat, or a response to another master, is heard
ANSWER_S = 0.1
ASKED = 3  # times, as a remote frame may be lost
STEP_S = 0.005
STATES = {int(state): state for state in NmtState} | {0: NmtState.PRE_OPERATIONAL}


def state_in(data: bytes) -> NmtState | None:
    """The state in a frame 700h + id, or None; PRE-OPERATIONAL for a boot-up."""
    return STATES.get(data[0] & 0x7F) if len(data) == 1 else None


def nmt_state(node: NodeAccess) -> NmtState:
    """By heartbeat (1017h), guarding (100Ch) or a remote frame; CommissioningError if not known."""
    heartbeat_s = node.integer(*HEARTBEAT_TIME, "H") / 1000
    with _received(node) as received:
        if heartbeat_s:
            _wait_until(node.master, LATE * heartbeat_s, lambda: received)
        else:
            _wait_until(node.master, LATE * node.integer(*GUARD_TIME, "H") / 1000, lambda: received)
            for _ in range(ASKED):
                if not received:
                    node.master.request(cob.ERROR_CONTROL + node.node_id)
                    _wait_until(node.master, ANSWER_S, lambda: received)
    states = [state for data in received if (state := state_in(data)) is not None]
    if states:
        return states[-1]
    raise CommissioningError(
        f"{node.name}: its NMT state is not known: neither a heartbeat nor a response to node guarding "
        f"({cob.ERROR_CONTROL + node.node_id:03X}h) is heard"
    )


@contextlib.contextmanager
def without_restart(node: NodeAccess) -> Iterator[None]:
    """CommissioningError at the end after a restart."""
    with _received(node) as received:
        yield
    if b"\0" in received:
        raise CommissioningError(f"{node.name} was restarted meanwhile (boot-up heard)")


@contextlib.contextmanager
def _received(node: NodeAccess) -> Iterator[list[bytes]]:
    received: list[bytes] = []

    def on_frame(can_id: int, data: bytes, at: float) -> None:
        received.append(bytes(data))

    with subscribed(node.master, [(cob.ERROR_CONTROL + node.node_id, on_frame)]):
        yield received


def _wait_until(master: Master, within_s: float, holds: Callable[[], object]) -> bool:
    end = master.now() + within_s
    while not (held := bool(holds())) and master.now() < end:
        master.wait(STEP_S)
    return held


WATCH_S = 0.6
LEAST_SAMPLES = 10  # of those in which it is watched
LARGEST_SPREAD_CYCLES = 0.02  # of the phase at standstill: noise, and a drive that holds its position
BOOT_UP_S = 5.0
VALID_S = 5.0  # a position that was lost is valid again after 256 samples at standstill
UNITS = 65536.0


@dataclass(frozen=True)
class MachineLook:
    """Spread of the phase in cycles, samples, cycles counted."""

    spread_cycles: float
    samples: int
    counted_cycles: int

    @property
    def moves(self) -> bool:
        return self.spread_cycles > LARGEST_SPREAD_CYCLES or self.counted_cycles != 0

    @property
    def text(self) -> str:
        if self.counted_cycles:
            return f"it has moved by {self.counted_cycles:+d} cycles in {WATCH_S:g} s"
        return f"its phase spreads over {self.spread_cycles:.3f} cycle in {self.samples} samples"


def watch_standstill(module: NodeAccess) -> MachineLook:
    master = module.master
    began = master.now()
    first: float | None = None
    low = high = 0.0
    seen: set[int] = set()
    counts: list[int] = []
    while master.now() - began < WATCH_S:
        status = module.integer(*od.FEEDBACK_STATUS, "H")
        number = module.integer(*od.FEEDBACK_SAMPLES, "I")
        phase = module.integer(*od.FEEDBACK_RAW_PHASE, "H") / UNITS
        if status & StatusBit.VALID:
            counts.append(module.integer(*od.FEEDBACK_CYCLE_COUNT, "q"))
        if not status & StatusBit.MISSED:
            seen.add(number)
            first = phase if first is None else first
            apart = (phase - first + 0.5) % 1.0 - 0.5
            low, high = min(low, apart), max(high, apart)
        master.wait(STEP_S)
    if len(seen) < LEAST_SAMPLES:
        raise CommissioningError(
            f"{module.name}: {len(seen)} samples in {WATCH_S:g} s, so it cannot be seen whether the machine "
            "stands still: SYNC, encoder interface and module must run (canfb node start). --force resets it "
            "nevertheless"
        )
    # A cycle more or less is a phase near 0, which goes to and fro with its noise.
    moved = counts[-1] - counts[0] if counts else 0
    return MachineLook(high - low, len(seen), moved if abs(moved) > 1 else 0)


def reset_nodes(
    master: Master, nodes: Sequence[int], command: NmtCommand = NmtCommand.RESET_NODE, *, force: bool = False
) -> list[dict[str, Any]]:
    """Reset nodes; CommissioningError, and no reset, if the machine of a module among them moves.

    A single module is started and waited for. ``force``: without a look. What was done, for programs.
    """
    found = [NodeAccess(master, node, "node") for node in nodes]
    modules = (
        []
        if force and len(found) > 1
        else [one for one in found if one.read_known(od.FEEDBACK_STATUS) is not None]
    )
    if len(found) == len(modules) == 1:
        return [reset_module(modules[0], command, force=force)]
    for module in () if force else modules:
        _refuse_motion(module)
    for node in found:
        master.send(0x000, struct.pack("BB", command, node.node_id))
    return [
        {"node": node.node_id, "forced": force, "spread_cycles": None, "position": None} for node in found
    ]


def _refuse_motion(module: NodeAccess) -> None:
    look = watch_standstill(module)
    if look.moves:
        raise CommissioningError(
            f"{module.name}: the machine moves, {look.text}: not reset. A start in motion may count wrong; "
            "stop the machine first. --force resets it nevertheless"
        )


def reset_module(
    module: NodeAccess, command: NmtCommand = NmtCommand.RESET_NODE, *, force: bool = False
) -> dict[str, Any]:
    """Reset a module at standstill, start it, and see that its position is valid.

    ``force``: without a look at the machine. CommissioningError if it moves or does not come back valid.
    """
    if not force:
        _refuse_motion(module)
    _restart(module, command)
    _wait_until(module.master, VALID_S, lambda: module.integer(*od.FEEDBACK_STATUS, "H") & StatusBit.VALID)
    status = module.integer(*od.FEEDBACK_STATUS, "H")
    if not status & StatusBit.VALID:
        words = ", ".join([str(od.position_state(status)), *od.fault_words(status)])
        raise CommissioningError(
            f"{module.name}: reset and started, but its position is {words}: canfb why {module.node_id:#04x} "
            "says why"
        )
    after = None if force else watch_standstill(module)
    if after is not None and after.moves:
        raise CommissioningError(
            f"{module.name}: the machine began to move while it was reset, {after.text}: its count may be "
            "wrong. Stop the machine, and reset it again"
        )
    return {
        "node": module.node_id,
        "forced": force,
        "spread_cycles": None if after is None else after.spread_cycles,
        "position": str(od.position_state(status)),
    }


def _restart(module: NodeAccess, command: NmtCommand) -> None:
    master, node = module.master, module.node_id
    with _received(module) as received:
        master.send(0x000, struct.pack("BB", command, node))
        started = _wait_until(master, BOOT_UP_S, lambda: b"\0" in received)
    if not started:
        raise CommissioningError(f"{module.name}: no boot-up within {BOOT_UP_S:g} s after the reset")
    master.send(0x000, struct.pack("BB", NmtCommand.START, node))
