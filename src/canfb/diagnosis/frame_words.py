"""CANopen frames in words: PDOs of modules by their mapping, all others by the predefined connection set."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

from canfb import objects as od
from canfb.cia301 import cob
from canfb.cia301.codes import EmergencyCode, emergency_text
from canfb.cia301.datatypes import DataType
from canfb.cia301.frame import Frame
from canfb.cia301.nmt import NmtCommand, NmtState
from canfb.master.access import CommissioningError, NodeAccess
from canfb.objects import Multiplexer
from canfb.sdo.object_description import ObjectDescription, ObjectDescriptions
from canfb.sdo.sdo_tasks import Reading
from canfb.view.pdo_map import Number, Pdo, Read, valid_pdos

PARAMETERS = (("TPDO", od.TPDO, od.TPDO_MAPPING), ("RPDO", od.RPDO, od.RPDO_MAPPING))
TIME, LSS_MASTER, LSS_SLAVE = 0x100, 0x7E5, 0x7E4
EMERGENCY = struct.Struct("<HB5s")
COMMANDS = {int(one): one.name.lower().replace("_", " ") for one in NmtCommand}
STATES = {int(one): one.name.replace("_", "-") for one in NmtState}


class _Field(NamedTuple):
    entry: ObjectDescription
    first_bit: int
    bits: int


class DecodedFrame(NamedTuple):
    """A frame and what it says.

    kind     tpdo, rpdo, sync, nmt, emcy, heartbeat, sdo request, sdo response, time, lss, "" for another
    node     the module whose mapping has decoded it, else by the predefined connection set; None: not known
    text     in words
    values   of a PDO, by object (6004:00): figures as the object has them
    """

    frame: Frame
    kind: str
    node: int | None
    text: str
    values: dict[str, Any]

    @property
    def is_pdo(self) -> bool:
        """It is a PDO of a module that is known."""
        return self.kind in ("tpdo", "rpdo")

    def line(self, time_s: float) -> str:
        """As candump has it, and the words."""
        data = "remote request" if self.frame.rtr else self.frame.data.hex(" ").upper()
        head = f"({time_s:.6f})  {self.frame.can_id:03X}  [{len(self.frame.data)}]"
        return f"{head}  {data:<23}  {self.text}".rstrip()

    def figures(self, time_s: float) -> dict[str, Any]:
        """For programs."""
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


@dataclass(frozen=True)
class _Pdo:
    """A PDO of a module; ``name`` is TPDO1 or RPDO1."""

    name: str
    node: int
    fields: tuple[_Field, ...]
    length_bytes: int
    product: str

    def decoded(self, frame: Frame) -> DecodedFrame:
        kind = self.name[:4].lower()
        if len(frame.data) < self.length_bytes:
            text = f"{self.name} of {self.node}: {len(frame.data)} bytes, {self.length_bytes} are mapped"
            return DecodedFrame(frame, kind, self.node, text, {})
        whole = int.from_bytes(frame.data, "little")
        words, values = [], {}
        for entry, first_bit, bits in self.fields:
            data = (whole >> first_bit & (1 << bits) - 1).to_bytes((bits + 7) // 8, "little")
            reading = Reading(entry, data, self.product)
            values[entry.number] = reading.figures()["value"]
            words.append(f"{entry.name[:1].lower()}{entry.name[1:]} {reading.text()}")
        return DecodedFrame(frame, kind, self.node, f"{self.name} of {self.node}: {', '.join(words)}", values)


class FrameWords:
    """Says what each frame of a bus is. ``modules`` gives for each module what its objects hold."""

    def __init__(self, described: ObjectDescriptions, modules: Iterable[tuple[int, Read]]) -> None:
        self._described = described
        self._pdos: dict[int, _Pdo] = {}
        for node, read in modules:
            for name, parameters, mapping in PARAMETERS:
                for pdo in valid_pdos(read, parameters, mapping):
                    self._learn(f"{name}{pdo.number}", node, pdo)

    def _learn(self, name: str, node: int, pdo: Pdo) -> None:
        if not pdo.entries:
            return
        fields, bit = [], 0
        for mapped in pdo.entries:
            entry, bits = self._described.find(mapped >> 16, mapped >> 8 & 0xFF), mapped & 0xFF
            if entry is not None and entry.data_type != DataType.DOMAIN:
                fields.append(_Field(entry, bit, bits))
            bit += bits
        decoded = _Pdo(name, node, tuple(fields), pdo.length_bytes, self._described.product)
        self._pdos.setdefault(pdo.can_id, decoded)  # several modules may take the same samples

    def decode(self, frame: Frame) -> DecodedFrame:
        """What a frame is; never raises."""
        pdo = self._pdos.get(frame.can_id)
        if pdo is not None and not frame.rtr:
            return pdo.decoded(frame)
        kind, node, text = _service(frame)
        return DecodedFrame(frame, kind, node, text, {})


def read_by_sdo(node: NodeAccess) -> Read | None:
    """The PDO mapping of a node as it is now, all of it read here; None if the node does not answer."""
    if not node.answers():
        return None
    values: dict[Multiplexer, Number | None] = {}

    def keep(place: Multiplexer) -> Number | None:
        try:
            values[place] = node.read_known(place)
        except CommissioningError:
            values[place] = None
        return values[place]

    for _, parameters, mapping in PARAMETERS:
        list(valid_pdos(keep, parameters, mapping))  # reads as it goes
    return values.get


def _service(frame: Frame) -> tuple[str, int | None, str]:
    """Kind, node and words of a frame of the predefined connection set."""
    can_id, data = frame.can_id, frame.data
    node = can_id & 0x7F
    function = can_id - node
    if frame.rtr:
        return "", node or None, f"remote request to {node}" if node else "remote request"
    if can_id == 0:
        return _nmt(data)
    if can_id == cob.SYNC:
        return "sync", None, f"SYNC, counter {data[0]}" if data else "SYNC"
    if can_id == TIME:
        return "time", None, "TIME"
    if can_id in (LSS_MASTER, LSS_SLAVE):
        return "lss", None, f"LSS, {'master' if can_id == LSS_MASTER else 'slave'}"
    if function == cob.EMERGENCY and len(data) == EMERGENCY.size:
        code, register, detail = EMERGENCY.unpack(data)
        meaning = emergency_text(code, od.EMERGENCY_TEXTS)
        words = f"EMCY of {node}: {code:04X}h {meaning}, 1001h {register:02X}h"
        cause = od.loss_cause(detail[2]) if code == EmergencyCode.SENSOR else None
        return "emcy", node, words if cause is None else f"{words}; lost: {cause.text}"
    if function == cob.ERROR_CONTROL and node and data:
        state = data[0] & 0x7F
        said = STATES.get(state, f"state {state}")
        return "heartbeat", node, f"boot-up of {node}" if not state else f"heartbeat of {node}: {said}"
    if function in (cob.SDO_REQUEST, cob.SDO_RESPONSE) and node:
        return _sdo(function, node, data)
    if function in cob.TPDOS:
        return "", node or None, f"PDO, TPDO{cob.TPDOS.index(function) + 1} of {node} by its CAN-ID"
    return "", None, ""


def _nmt(data: bytes) -> tuple[str, int | None, str]:
    if len(data) != 2:
        return "nmt", None, "NMT, wrong length"
    command = COMMANDS.get(data[0], f"command {data[0]}")
    return "nmt", data[1] or None, f"NMT {command}: {data[1] or 'all nodes'}"


def _sdo(function: int, node: int, data: bytes) -> tuple[str, int | None, str]:
    kind, way = ("sdo request", "to") if function == cob.SDO_REQUEST else ("sdo response", "of")
    initiates = len(data) == 8 and data[0] >> 5 in (1, 2, 3, 4)
    place = f", {struct.unpack_from('<H', data, 1)[0]:04X}:{data[3]:02X}" if initiates else ""
    abort = ", abort" if data[:1] == b"\x80" else ""
    return kind, node, f"{kind.replace('sdo', 'SDO')} {way} {node}{place}{abort}"
