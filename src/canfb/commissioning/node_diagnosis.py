"""What a diagnosis says of a node on the bus: all objects that can be read, by SDO."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from canfb.cia301.datatypes import DataType
from canfb.commissioning.access import CommissioningError, Master, NodeAccess, RefusedError
from canfb.commissioning.object_description import ObjectDescriptions
from canfb.commissioning.sdo_tasks import Reading, described_by
from canfb.errors import CanfbError

Figures = dict[str, Any]


def node_facts(master: Master, node_id: int, known: Iterable[Path]) -> Figures:
    """The objects of a node whose EDS is one of those ``known``, by number; else why not.

    An object that is refused has the reason in its place. Nothing is written.
    """
    node = NodeAccess(master, node_id, "node")
    facts: Figures = {"node_id": node_id}
    try:
        described = described_by(node, known, "1000")
    except CanfbError as error:
        return facts | {"error": str(error)}
    objects: Figures = {}
    facts |= {"product": described.product, "objects": objects}
    try:
        _read_all(node, described, objects)
    except CommissioningError as error:  # it does not answer any more
        facts["error"] = str(error)
    return facts


def _read_all(node: NodeAccess, described: ObjectDescriptions, objects: Figures) -> None:
    for entry in described:
        if not entry.readable or entry.data_type == DataType.DOMAIN:
            continue
        try:
            reading = Reading(entry, node.read_bytes(*entry.place), described.product)
            objects[entry.number] = reading.figures()["value"]
        except RefusedError as error:
            objects[entry.number] = f"refused: {error.code:08X}h"


class HeardFrames:
    """Counts the frames of all CAN-IDs with 11 bits while it listens."""

    def __init__(self) -> None:
        self._counts: dict[int, int] = {}

    def listen(self, master: Master, seconds: float) -> dict[str, int]:
        """Frames within ``seconds``, by CAN-ID."""
        for can_id in range(0x800):
            master.subscribe(can_id, self._hear)
        try:
            master.wait(seconds)
        finally:
            for can_id in range(0x800):
                master.unsubscribe(can_id, self._hear)
        return {f"{can_id:03X}": count for can_id, count in sorted(self._counts.items())}

    def _hear(self, can_id: int, data: bytes, at: float) -> None:
        self._counts[can_id] = self._counts.get(can_id, 0) + 1
