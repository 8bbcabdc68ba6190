"""The objects in a PDO of the module, and by how much two of these PDOs differ."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from canfb import objects as od
from canfb.cia301 import datatypes
from canfb.device.od.dictionary import Dictionary
from canfb.view.pdo_map import valid_pdos


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
        pdos = valid_pdos(lambda place: _value(dictionary, place), od.TPDO, od.TPDO_MAPPING)
        first_bit = 0
        for entry in next((pdo.entries for pdo in pdos if pdo.can_id == can_id), ()):
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


def _value(dictionary: Dictionary, place: od.Multiplexer) -> int | None:
    entry = dictionary.find(*place)
    return None if entry is None else int(entry.value)
