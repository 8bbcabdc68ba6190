"""What the recorded module sent against what the replayed one sends, byte for byte and object for object."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from canfb import objects as od
from canfb.cia301 import datatypes
from canfb.device.od.dictionary import Dictionary
from canfb.view.pdo_map import valid_pdos

UPLOADED = (b"\x43", b"\x47", b"\x4b", b"\x4f")  # expedited, size indicated (CiA 301, 7.2.4.3.6)
LONGEST_DELAY_S = 1.0
"""Longest time between a frame and its counterpart, s."""


class OwnFrames:
    """Pairs the frames of one CAN-ID, in their order; an equal frame among those that wait is preferred.

    equal, different   pairs
    only_recorded      frames of the log that the replay did not send
    only_replayed      the other way round
    first              of the different ones: when (stamp of the log, seconds), recorded and replayed data
    uploads            objects that were read, by expedited SDO transfers, with another value
    differences        what ``fields`` gave for the first pair that is not equal: what the frame is made of
    """

    def __init__(self, fields: Callable[[], list[FieldDifference]]) -> None:
        self.equal = self.different = self.only_recorded = self.only_replayed = 0
        self.first: tuple[float, bytes, bytes] | None = None
        self.uploads = set[str]()
        self.differences: list[FieldDifference] = []
        self._fields = fields
        self._replayed: deque[tuple[float, bytes]] = deque()
        self._recorded: deque[tuple[float, bytes]] = deque()

    def replayed(self, data: bytes, now: float) -> None:
        if self._recorded:
            self.only_recorded += _drop_late(self._recorded, now)
            before = _taken(self._recorded, data)
            if before is not None:
                self.only_recorded += before
                self.equal += 1
                return
        waiting = self._replayed
        if waiting and now - waiting[0][0] > LONGEST_DELAY_S:
            self.only_replayed += _drop_late(waiting, now)
        waiting.append((now, data))

    def recorded(self, data: bytes, now: float, stamp_s: float) -> None:
        waiting = self._replayed
        if waiting and waiting[0][1] == data:
            waiting.popleft()
            self.equal += 1
            return
        self.only_replayed += _drop_late(waiting, now)
        before = _taken(waiting, data)
        if before is not None:
            self.only_replayed += before
            self.equal += 1
        elif waiting:
            _, replayed = waiting.popleft()
            self.different += 1
            if self.first is None:
                self.first = (stamp_s, data, replayed)
                self.differences = self._fields()
            if data[:1] in UPLOADED and data[:4] == replayed[:4]:
                self.uploads.add(f"{data[2]:02X}{data[1]:02X}h:{data[3]:02X}")
            for one in self.differences:
                one.note(int.from_bytes(data, "little"), int.from_bytes(replayed, "little"))
        else:
            self.only_recorded += _drop_late(self._recorded, now)
            self._recorded.append((now, data))

    def close(self, now: float) -> None:
        self.only_replayed += _drop_late(self._replayed, now)
        self.only_recorded += len(self._recorded)
        self._replayed.clear()
        self._recorded.clear()


def _drop_late(waiting: deque[tuple[float, bytes]], now: float) -> int:
    """Take out what has waited too long; how many."""
    dropped = 0
    while waiting and now - waiting[0][0] > LONGEST_DELAY_S:
        waiting.popleft()
        dropped += 1
    return dropped


def _taken(waiting: deque[tuple[float, bytes]], data: bytes) -> int | None:
    """Take out the first equal one and those before it; how many there were, None without an equal one."""
    for place, (_, other) in enumerate(waiting):
        if other == data:
            for _ in range(place + 1):
                waiting.popleft()
            return place
    return None


@dataclass
class FieldDifference:
    """Replayed less recorded value of one object, over the pairs that differ; integers modulo their width."""

    name: str
    data_type: int
    first_bit: int
    bits: int
    pairs: int = 0
    least: float = math.inf
    most: float = -math.inf

    def note(self, recorded: int, replayed: int) -> None:
        one, other = (whole >> self.first_bit & (1 << self.bits) - 1 for whole in (recorded, replayed))
        if self.data_type in datatypes.FLOATS:
            values = [
                datatypes.decode(self.data_type, raw.to_bytes(self.bits // 8, "little"))
                for raw in (one, other)
            ]
            apart = 0.0 if one == other else float(values[1]) - float(values[0])
        else:
            half = 1 << (self.bits - 1)
            apart = float((other - one + half) % (2 * half) - half)
        self.pairs += bool(apart)
        self.least, self.most = min(self.least, apart), max(self.most, apart)


def pdo_fields(dictionary: Dictionary, can_id: int) -> list[FieldDifference]:
    """The fields of the TPDO with a CAN-ID as mapped now; none for other frames."""

    def read(place: od.Multiplexer) -> int | None:
        entry = dictionary.find(*place)
        return None if entry is None else int(entry.value)

    fields: list[FieldDifference] = []
    pdos = valid_pdos(read, od.TPDO, od.TPDO_MAPPING)
    first_bit = 0
    for entry in next((pdo.entries for pdo in pdos if pdo.can_id == can_id), ()):
        index, subindex, bits = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
        mapped = dictionary.find(index, subindex)
        data_type = datatypes.DataType.UNSIGNED64 if mapped is None else mapped.data_type
        fields.append(FieldDifference(f"{index:04X}h:{subindex:02X}", data_type, first_bit, bits))
        first_bit += bits
    return fields
