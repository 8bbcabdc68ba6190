"""Who is on a bus: the nodes that answer 1000h, or send a heartbeat.

The NMT state is that of the heartbeat, or asked for by a remote frame unless a master may be guarding the
node (100Ch), whose toggle bit that would upset.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from canfb import objects as od
from canfb.cia301 import cob
from canfb.cia301.datatypes import DataType
from canfb.cia301.nmt import NmtState
from canfb.errors import CanfbError
from canfb.master.access import CommissioningError, Master, NodeAccess, RefusedError, subscribed
from canfb.master.node_state import GUARD_TIME, state_in
from canfb.rows import those
from canfb.sdo.object_description import ObjectDescriptions
from canfb.sdo.sdo_tasks import Reading, described_by

NODES = range(1, 128)
EVERY = 16  # requests at once: adapters have short queues
PAUSE_S = 0.005
DEVICE_NAME = (0x1008, 0)
STATE_S = 0.05  # for the answer to a remote frame
REQUEST = struct.pack("<BHB4x", 0x40, *od.DEVICE_TYPE)


@dataclass(frozen=True)
class FoundNode:
    """None: not known."""

    node_id: int
    state: str | None
    name: str | None = None
    device_type: int | None = None
    vendor_id: int | None = None
    product_code: int | None = None
    revision: int | None = None
    serial_number: int | None = None

    def figures(self) -> dict[str, Any]:
        figures = asdict(self)
        return {"node": figures.pop("node_id"), **figures}

    def line(self) -> str:
        head = f"{self.node_id:3} ({self.node_id:02X}h)  {self.state or 'state not known':15}"
        vendor, revision = self.vendor_id, self.revision or 0
        parts = those(
            (self.device_type is None, "answers no SDO"),
            (self.device_type is not None, self.name or f"device type {self.device_type or 0:08X}h"),
            (vendor is not None, f"vendor {vendor or 0:X}h product {self.product_code or 0:X}h"),
            (self.revision is not None, f"revision {revision >> 16}.{revision & 0xFFFF}"),
            (self.serial_number is not None, f"serial {self.serial_number}"),
        )
        return f"{head}  {', '.join(parts)}"


def scan(master: Master, listen_s: float) -> list[FoundNode]:
    """Within ``listen_s``. CanfbError if the bus fails."""
    answers: set[int] = set()
    states: dict[int, NmtState | None] = {}

    def answered(can_id: int, data: bytes, at: float) -> None:
        answers.add(can_id - cob.SDO_RESPONSE)

    def heartbeat(can_id: int, data: bytes, at: float) -> None:
        if len(data) == 1:
            states[can_id - cob.ERROR_CONTROL] = state_in(data)

    with subscribed(master, [(cob.ERROR_CONTROL + node, heartbeat) for node in NODES]):
        with subscribed(master, [(cob.SDO_RESPONSE + node, answered) for node in NODES]):
            end = master.now() + listen_s
            for node in NODES:
                master.send(cob.SDO_REQUEST + node, REQUEST)
                if node % EVERY == 0:
                    master.wait(PAUSE_S)
            master.wait(max(0.0, end - master.now()))
        found = []
        for node in sorted(answers | set(states)):
            access = NodeAccess(master, node, "node")
            if node in answers and node not in states and not access.integer_if_there(GUARD_TIME, "H"):
                master.request(cob.ERROR_CONTROL + node)
                master.wait(STATE_S)
            state = states.get(node)
            found.append(_described(access, state) if node in answers else FoundNode(node, _state(state)))
        return found


def _described(node: NodeAccess, state: NmtState | None) -> FoundNode:
    vendor, product, revision, serial = (node.integer_if_there(place, "I") for place in od.IDENTITY)
    device_type = node.integer_if_there(od.DEVICE_TYPE, "I") or 0
    try:
        name = node.read_bytes(*DEVICE_NAME).decode("latin-1").rstrip("\0").strip()
    except CommissioningError:
        name = ""
    words = name if name.isprintable() and name else None
    return FoundNode(node.node_id, _state(state), words, device_type, vendor, product, revision, serial)


def _state(state: NmtState | None) -> str | None:
    return None if state is None else state.name.replace("_", "-")


def node_facts(master: Master, node_id: int, known: Iterable[Path]) -> dict[str, Any]:
    """The readable objects of a node whose EDS is ``known``, by number; else why not."""
    node = NodeAccess(master, node_id, "node")
    facts: dict[str, Any] = {"node_id": node_id}
    try:
        described = described_by(node, known, "1000")
    except CanfbError as error:
        return facts | {"error": str(error)}
    objects: dict[str, Any] = {}
    facts |= {"product": described.product, "objects": objects}
    try:
        _read_all(node, described, objects)
    except CommissioningError as error:  # it does not answer any more
        facts["error"] = str(error)
    return facts


def _read_all(node: NodeAccess, described: ObjectDescriptions, objects: dict[str, Any]) -> None:
    for entry in described:
        if not entry.readable or entry.data_type == DataType.DOMAIN:
            continue
        try:
            reading = Reading(entry, node.read_bytes(*entry.place), described.product)
            objects[entry.number] = reading.figures()["value"]
        except RefusedError as error:
            objects[entry.number] = f"refused: {error.code:08X}h"


def frame_counts(master: Master, seconds: float) -> dict[str, int]:
    counts: Counter[int] = Counter()

    def count(can_id: int, data: bytes, at: float) -> None:
        counts[can_id] += 1

    with subscribed(master, [(can_id, count) for can_id in range(0x800)]):
        master.wait(seconds)
    return {f"{can_id:03X}": number for can_id, number in sorted(counts.items())}
