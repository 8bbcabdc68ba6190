"""The objects in a PDO of the module, and by how much two of these PDOs differ."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from canfb import objects as od
from canfb.cia301 import cob, datatypes
from canfb.device.od.dictionary import Dictionary

HIGHEST_TPDO = 512


@dataclass
class FieldDifference:
    """Replayed less recorded value of one object, over the pairs that differ; integers modulo their width."""

    name: str
    pairs: int = 0
    least: float = math.inf
    most: float = -math.inf

    @property
    def is_constant(self) -> bool:
        """Every pair differs by the same amount."""
        return self.pairs > 0 and self.least == self.most


@dataclass(frozen=True)
class _Field:
    name: str
    data_type: int
    first_bit: int
    bits: int

    def value(self, whole: int) -> Any:
        raw = whole >> self.first_bit & (1 << self.bits) - 1
        if self.data_type in datatypes.FLOATS:
            return datatypes.decode(self.data_type, raw.to_bytes(self.bits // 8, "little"))
        return raw

    def difference(self, recorded: int, replayed: int) -> float:
        one, other = self.value(recorded), self.value(replayed)
        if self.data_type in datatypes.FLOATS:
            apart = float(other) - float(one)
            return 0.0 if math.isnan(apart) and math.isnan(one) and math.isnan(other) else apart
        turn = 1 << self.bits
        apart = (other - one) % turn
        return float(apart - turn if apart >= turn // 2 else apart)


class PdoFields:
    """The fields of the TPDO with a CAN-ID as it is mapped now; none for other frames."""

    def __init__(self, dictionary: Dictionary, can_id: int) -> None:
        self.differences: list[FieldDifference] = []
        self._fields: list[_Field] = []
        number = _tpdo_with(dictionary, can_id)
        if number is None:
            return
        first_bit = 0
        for place in range(1, _value(dictionary, od.TPDO_MAPPING + number, 0) + 1):
            entry = _value(dictionary, od.TPDO_MAPPING + number, place)
            index, subindex, bits = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
            mapped = dictionary.find(index, subindex)
            name = f"{index:04X}h:{subindex:02X}"
            data_type = datatypes.DataType.UNSIGNED64 if mapped is None else mapped.data_type
            self._fields.append(_Field(name, data_type, first_bit, bits))
            self.differences.append(FieldDifference(name))
            first_bit += bits

    def note(self, recorded: bytes, replayed: bytes) -> None:
        """A pair that differs."""
        one, other = int.from_bytes(recorded, "little"), int.from_bytes(replayed, "little")
        for field, found in zip(self._fields, self.differences, strict=True):
            apart = field.difference(one, other)
            if apart:
                found.pairs += 1
            found.least, found.most = min(found.least, apart), max(found.most, apart)


def _tpdo_with(dictionary: Dictionary, can_id: int) -> int | None:
    for number in range(HIGHEST_TPDO):
        entry = dictionary.find(od.TPDO + number, 1)
        if entry is None:
            return None
        if cob.is_valid(entry.value) and entry.value & cob.CAN_ID == can_id:
            return number
    return None


def _value(dictionary: Dictionary, index: int, subindex: int) -> int:
    entry = dictionary.find(index, subindex)
    return 0 if entry is None else int(entry.value)
