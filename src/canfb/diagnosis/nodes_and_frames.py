"""Nodes on a bus, which answer 1000h or send a heartbeat; CANopen frames in words.

The NMT state is read from the heartbeat, or requested by a remote frame. It is not requested if a master may
guard the node (100Ch): the answer would disturb the toggle bit.
"""

from __future__ import annotations

import contextlib
import struct
from collections import Counter
from collections.abc import Container, Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from canfb import objects as od
from canfb.cia301 import cob
from canfb.cia301.codes import EMERGENCY, EmergencyCode, NmtCommand, NmtState, emergency_text
from canfb.cia301.datatypes import DataType
from canfb.cia301.frame import Frame
from canfb.errors import CanfbError
from canfb.master.access import (
    GUARD_TIME,
    CommissioningError,
    Master,
    NodeAccess,
    RefusedError,
    received,
    state_in,
    subscribed,
)
from canfb.rows import those
from canfb.sdo.object_description import ObjectDescriptions
from canfb.sdo.sdo_tasks import Reading, described_by
from canfb.view.module_view import Pdo, Read, valid_pdos

EVERY = 8  # requests sent without a pause: SocketCAN queues 10 frames
PAUSE_S = 0.008  # enough for these at 125 kbit/s
DEVICE_NAME = (0x1008, 0)
STATE_S = 0.05  # time for the answer to a remote frame
REQUEST = struct.pack("<BHB4x", 0x40, *od.DEVICE_TYPE)


@dataclass(frozen=True)
class FoundNode:
    """A node on the bus; None: not known."""

    node: int
    state: str | None
    name: str | None = None
    device_type: int | None = None
    vendor_id: int | None = None
    product_code: int | None = None
    revision: int | None = None
    serial_number: int | None = None

    @property
    def answers(self) -> bool:
        """Whether it answers SDO."""
        return self != FoundNode(self.node, self.state)

    def figures(self) -> dict[str, Any]:
        return asdict(self)

    def line(self) -> str:
        head = f"{self.node:3} ({self.node:02X}h)  {self.state or 'state not known':15}"
        vendor, revision = self.vendor_id, self.revision or 0
        kind = "not known" if self.device_type is None else f"{self.device_type:08X}h"
        parts = those(
            (not self.answers, "answers no SDO"),
            (self.answers, self.name or f"device type {kind}"),
            (vendor is not None, f"vendor {vendor or 0:X}h product {self.product_code or 0:X}h"),
            (self.revision is not None, f"revision {revision >> 16}.{revision & 0xFFFF}"),
            (self.serial_number is not None, f"serial {self.serial_number}"),
        )
        return f"{head}  {', '.join(parts)}"


def scan(master: Master, listen_s: float) -> list[FoundNode]:
    """Nodes found within ``listen_s``. CanfbError if the bus fails."""
    with contextlib.ExitStack() as hearing:

        def heard_of(function: int) -> dict[int, list[bytes]]:
            return {node: hearing.enter_context(received(master, function + node)) for node in cob.NODES}

        control, answers = heard_of(cob.ERROR_CONTROL), heard_of(cob.SDO_RESPONSE)
        end = master.now() + listen_s
        for node in cob.NODES:
            master.send(cob.SDO_REQUEST + node, REQUEST)
            if node % EVERY == 0:
                master.wait(PAUSE_S)
        master.wait(max(0.0, end - master.now()))
        found = []
        for node in [one for one in cob.NODES if answers[one] or control[one]]:
            access = NodeAccess(master, node, "node")
            if not control[node] and not access.integer_if_there(GUARD_TIME, "H"):
                master.send(cob.ERROR_CONTROL + node, b"", remote=True)
                master.wait(STATE_S)
            state = next(map(state_in, reversed(control[node])), None)
            found.append(_described(access, state) if answers[node] else FoundNode(node, STATES.get(state)))
        return found


def _described(node: NodeAccess, state: NmtState | None) -> FoundNode:
    vendor, product, revision, serial = (node.integer_if_there(place, "I") for place in od.IDENTITY)
    device_type = node.integer_if_there(od.DEVICE_TYPE, "I")
    try:
        name = node.read_bytes(*DEVICE_NAME).decode("latin-1").rstrip("\0").strip()
    except CommissioningError:
        name = ""
    words = name if name.isprintable() and name else None
    return FoundNode(node.node_id, STATES.get(state), words, device_type, vendor, product, revision, serial)


def node_facts(master: Master, node_id: int, known: Iterable[Path]) -> dict[str, Any]:
    """The readable objects of a node whose EDS is ``known``, by number, or why not."""
    node = NodeAccess(master, node_id, "node")
    objects: dict[str, Any] = {}
    facts: dict[str, Any] = {"node_id": node_id}
    try:
        described = described_by(node, known, "1000")
        facts |= {"product": described.product, "objects": objects}
        _read_all(node, described, objects)
    except CanfbError as error:  # an unknown node, or node or bus no longer answer
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


PARAMETERS = (("TPDO", od.TPDO, od.TPDO_MAPPING), ("RPDO", od.RPDO, od.RPDO_MAPPING))
SCAN_S = 0.2
FIXED = {
    0x100: ("time", None, "TIME"),
    0x7E5: ("lss", None, "LSS, master"),
    0x7E4: ("lss", None, "LSS, slave"),
}
# Words, and the command bytes that index and sub-index follow; in segments data follows (CiA 301, 7.2.4.3).
SDO = {
    cob.SDO_REQUEST: ("SDO request", "to", {*range(0x20, 0x30), 0x40, 0x80}),
    cob.SDO_RESPONSE: ("SDO response", "of", {*range(0x40, 0x50), 0x60, 0x80}),
}
COMMANDS = {int(one): one.name.lower().replace("_", " ") for one in NmtCommand}
STATES: dict[int | None, str] = {int(one): one.name.replace("_", "-") for one in NmtState}


class DecodedFrame(NamedTuple):
    """A frame and its meaning.

    kind     tpdo, rpdo, sync, nmt, emcy, heartbeat, sdo request, sdo response, time, lss, ""
    node     None: not known
    values   values of a PDO, by object (6004:00)
    """

    frame: Frame
    kind: str
    node: int | None
    text: str
    values: dict[str, Any]

    @property
    def is_pdo(self) -> bool:
        return self.kind in ("tpdo", "rpdo")

    def line(self, time_s: float) -> str:
        """The format of candump, with the meaning."""
        data = "remote request" if self.frame.rtr else self.frame.data.hex(" ").upper()
        head = f"({time_s:.6f})  {self.frame.can_id:03X}  [{len(self.frame.data)}]"
        return f"{head}  {data:<23}  {self.text}".rstrip()

    def figures(self, time_s: float) -> dict[str, Any]:
        return {
            "time_s": round(time_s, 6),
            "can_id": self.frame.can_id,
            "data": self.frame.data.hex(),
            "rtr": self.frame.rtr,
            "kind": self.kind or None,
            "node": self.node,
            "text": self.text,
            "values": self.values,
        }


class FrameWords:
    """Decodes frames, and PDOs of modules that it has learned."""

    def __init__(self, described: ObjectDescriptions) -> None:
        self._described = described
        self._pdos: dict[int, tuple[str, int, Pdo]] = {}
        self._modules: set[int] = set()

    def learn(self, node: int, read: Read) -> None:
        self._modules.add(node)
        for name, parameters, mapping in PARAMETERS:
            for pdo in valid_pdos(read, parameters, mapping):
                if pdo.entries:
                    self._pdos.setdefault(pdo.can_id, (f"{name}{pdo.number}", node, pdo))

    def decode(self, frame: Frame) -> DecodedFrame:
        """Meaning of a frame; never raises."""
        known = self._pdos.get(frame.can_id)
        if known is not None and not frame.rtr:
            return self._decoded(frame, *known)
        kind, node, text = _service(frame, self._modules)
        return DecodedFrame(frame, kind, node, text, {})

    def _decoded(self, frame: Frame, name: str, node: int, pdo: Pdo) -> DecodedFrame:
        kind = name[:4].lower()
        if len(frame.data) < pdo.length_bytes:
            text = f"{name} of {node}: {len(frame.data)} bytes, {pdo.length_bytes} are mapped"
            return DecodedFrame(frame, kind, node, text, {})
        words, values = [], {}
        for place, data in pdo.values(frame.data).items():
            entry = self._described.find(*place)
            if entry is not None and entry.data_type != DataType.DOMAIN:
                reading = Reading(entry, data, self._described.product)
                values[entry.number] = reading.figures()["value"]
                words.append(f"{entry.name[:1].lower()}{entry.name[1:]} {reading.text()}")
        return DecodedFrame(frame, kind, node, f"{name} of {node}: {', '.join(words)}", values)


def learn_by_sdo(words: FrameWords, master: Master, nodes: Iterable[int]) -> set[int]:
    known = set()
    for node in nodes or [one.node for one in scan(master, SCAN_S) if one.answers]:
        read = NodeAccess(master, node, "module").read_known
        with contextlib.suppress(CommissioningError):
            if read(od.TABLE_ACTIVE_CRC) is not None:
                words.learn(node, read)
                known.add(node)
    return known


def _service(frame: Frame, modules: Container[int]) -> tuple[str, int | None, str]:
    can_id, data = frame.can_id, frame.data
    node = can_id & 0x7F
    function = can_id - node
    if frame.rtr:
        return "", node or None, f"remote request to {node}" if node else "remote request"
    if can_id == 0:
        return _nmt(data)
    if can_id == cob.SYNC:
        return "sync", None, f"SYNC, counter {data[0]}" if data else "SYNC"
    if function == cob.EMERGENCY and len(data) == EMERGENCY.size:
        return "emcy", node, _emergency(node, data, od.EMERGENCY_TEXTS if node in modules else {})
    if function == cob.ERROR_CONTROL and node and data:
        return "heartbeat", node, _heartbeat(node, data[0] & 0x7F)
    if function in SDO and node:
        kind, way, initiating = SDO[function]
        return kind.lower(), node, f"{kind} {way} {node}{_sdo(data, initiating)}"
    if function in cob.TPDOS and node:
        return "", node, f"PDO, TPDO{cob.TPDOS.index(function) + 1} of {node} by its CAN-ID"
    return FIXED.get(can_id, ("", None, ""))


def _nmt(data: bytes) -> tuple[str, int | None, str]:
    if len(data) != 2:
        return "nmt", None, "NMT, wrong length"
    command, node = COMMANDS.get(data[0], f"command {data[0]}"), data[1] or None
    return "nmt", node, f"NMT {command}: {node or 'all nodes'}"


def _heartbeat(node: int, state: int) -> str:
    return f"heartbeat of {node}: {STATES.get(state, f'state {state}')}" if state else f"boot-up of {node}"


def _emergency(node: int, data: bytes, own: Mapping[int, str]) -> str:
    code, register, detail = EMERGENCY.unpack(data)
    cause = od.loss_cause(detail[2]) if own and code == EmergencyCode.SENSOR else None
    lost = "" if cause is None else f"; lost: {cause.text}"
    return f"EMCY of {node}: {code:04X}h {emergency_text(code, own)}, 1001h {register:02X}h{lost}"


def _sdo(data: bytes, initiating: Container[int]) -> str:
    initiates = len(data) == 8 and data[0] in initiating
    place = f", {struct.unpack_from('<H', data, 1)[0]:04X}:{data[3]:02X}" if initiates else ""
    return f"{place}, abort" if data[:1] == b"\x80" else place
