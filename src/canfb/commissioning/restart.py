"""Restarting a module, at standstill only.

A module that starts on a turning machine may take it for one at rest: at whole cycles per interval the
samples are the same. So they are watched before the reset and after it, and a machine that moves is refused.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

from canfb import objects as od
from canfb.cia301 import cob
from canfb.cia301.nmt import NmtCommand
from canfb.commissioning.access import CommissioningError, NodeAccess
from canfb.objects import StatusBit

WATCH_S = 0.6
EVERY_S = 0.005
LEAST_SAMPLES = 10  # of those in which it is watched
LARGEST_SPREAD_CYCLES = 0.02  # of the phase at standstill: noise, and a drive that holds its position
BOOT_UP_S = 5.0
VALID_S = 5.0  # a position that was lost is valid again after 256 samples at standstill
UNITS = 65536.0


@dataclass(frozen=True)
class MachineLook:
    """How a machine looked: the spread of the phase in cycles, samples, and by how much the count moved."""

    spread_cycles: float
    samples: int
    counted_cycles: int

    @property
    def moves(self) -> bool:
        """It is no standstill."""
        return self.spread_cycles > LARGEST_SPREAD_CYCLES or self.counted_cycles != 0

    @property
    def text(self) -> str:
        """In words."""
        if self.counted_cycles:
            return f"it has moved by {self.counted_cycles:+d} cycles in {WATCH_S:g} s"
        return f"its phase spreads over {self.spread_cycles:.3f} cycle in {self.samples} samples"


def watch_standstill(module: NodeAccess) -> MachineLook:
    """Watch the phase of a module for a moment. CommissioningError if it gets too few samples."""
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
        master.wait(EVERY_S)
    if len(seen) < LEAST_SAMPLES:
        raise CommissioningError(
            f"{module.name}: {len(seen)} samples in {WATCH_S:g} s, so it cannot be seen whether the machine "
            "stands still: SYNC, encoder interface and module must run (canfb nmt start). --force resets it "
            "nevertheless"
        )
    # A cycle more or less is a phase near 0, which goes to and fro with its noise.
    moved = counts[-1] - counts[0] if counts else 0
    return MachineLook(high - low, len(seen), moved if abs(moved) > 1 else 0)


def reset_module(module: NodeAccess, *, force: bool = False) -> dict[str, Any]:
    """Reset a module whose machine stands still, start it, and see that its position is valid.

    ``force``: without a look at the machine. What was done, for programs. CommissioningError if the machine
    moves, if the module does not come back, and if its position is not valid afterwards.
    """
    before = None if force else watch_standstill(module)
    if before is not None and before.moves:
        raise CommissioningError(
            f"{module.name}: the machine moves, {before.text}: not reset. A start in motion may count wrong; "
            "stop the machine first. --force resets it nevertheless"
        )
    _restart(module)
    status = _wait_for_valid(module)
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


def _restart(module: NodeAccess) -> None:
    master, node = module.master, module.node_id
    booted: list[float] = []

    def hear(can_id: int, data: bytes, at: float) -> None:
        if data[:1] == b"\x00":
            booted.append(at)

    master.subscribe(cob.ERROR_CONTROL + node, hear)
    try:
        master.send(0x000, struct.pack("BB", NmtCommand.RESET_NODE, node))
        end = master.now() + BOOT_UP_S
        while not booted and master.now() < end:
            master.wait(EVERY_S)
    finally:
        master.unsubscribe(cob.ERROR_CONTROL + node, hear)
    if not booted:
        raise CommissioningError(f"{module.name}: no boot-up within {BOOT_UP_S:g} s after the reset")
    master.send(0x000, struct.pack("BB", NmtCommand.START, node))


def _wait_for_valid(module: NodeAccess) -> int:
    """The status word once the position is valid, or after a while."""
    master = module.master
    end = master.now() + VALID_S
    while True:
        status = module.integer(*od.FEEDBACK_STATUS, "H")
        if status & StatusBit.VALID or master.now() >= end:
            return status
        master.wait(EVERY_S)
