"""PDO parameters and mapping (CiA 301, 7.5.2.35 to 7.5.2.38): what may be written when.

Mapped objects follow each other, least significant bit first; `packer` or `unpacker` is compiled once. The
`on_check` of each entry checks its step of the procedure, for SDO writes, restored values and DCF alike.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from enum import Enum
from typing import NamedTuple

from canfb.cia301 import cob, datatypes
from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.cia301.frame import LONGEST_BITS as LONGEST_BITS
from canfb.device.od.dictionary import RPDO_ACCESS, TPDO_ACCESS, Dictionary, Entry


class Direction(Enum):
    """Seen from the device."""

    RECEIVE = "RPDO"
    TRANSMIT = "TPDO"


ACCESS = {Direction.RECEIVE: RPDO_ACCESS, Direction.TRANSMIT: TPDO_ACCESS}


class Slot(NamedTuple):
    """A mapped object; entry None for a dummy."""

    entry: Entry | None
    data_type: int
    bits: int


def resolve(dictionary: Dictionary, mapping: int, direction: Direction) -> Slot:
    """The object of a mapping entry (index, sub-index, bits). SdoAbort if it does not exist or cannot be
    mapped.
    """
    index, subindex, bits = mapping >> 16, mapping >> 8 & 0xFF, mapping & 0xFF
    if index in dictionary.dummies and direction is Direction.RECEIVE:
        if subindex or bits != datatypes.bit_length(index):
            raise SdoAbort(AbortCode.NOT_MAPPABLE)
        return Slot(None, index, bits)
    entry = dictionary.find(index, subindex)
    if entry is None:
        raise SdoAbort(AbortCode.NO_OBJECT)
    allowed = entry.pdo_mappable and entry.access in ACCESS[direction]
    if not allowed or not bits or bits != entry.bit_length:
        raise SdoAbort(AbortCode.NOT_MAPPABLE)
    return Slot(entry, entry.data_type, bits)


def resolve_all(dictionary: Dictionary, mappings: Sequence[int], direction: Direction) -> list[Slot]:
    slots = [resolve(dictionary, mapping, direction) for mapping in mappings]
    if sum(slot.bits for slot in slots) > LONGEST_BITS:
        raise SdoAbort(AbortCode.PDO_LENGTH)
    return slots


SYNCHRONOUS = range(241)  # Transmission types that act at a SYNC.
SYNC_REMOTE = 0xFC
EVENT_REMOTE = 0xFD
EVENT_DRIVEN = frozenset({0xFE, 0xFF})
REMOTE_ONLY = frozenset({SYNC_REMOTE, EVENT_REMOTE})

COMMUNICATION = {Direction.RECEIVE: 0x1400, Direction.TRANSMIT: 0x1800}
MAPPING = {Direction.RECEIVE: 0x1600, Direction.TRANSMIT: 0x1A00}
PDO_NUMBERS = range(1, 513)


def numbers(dictionary: Dictionary, direction: Direction) -> list[int]:
    first = COMMUNICATION[direction]
    return [index - first + 1 for index in dictionary.indices(range(first, first + len(PDO_NUMBERS)))]


class PdoParameters:
    """14xxh and 16xxh, or 18xxh and 1Axxh, of one PDO, with the checks of the procedure.

    While the PDO is not valid its communication parameters can be written in any order; their combination
    is checked when bit 31 is cleared. `changed` is called after each accepted change.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        number: int,
        direction: Direction,
        changed: Callable[[], None],
    ) -> None:
        self._dictionary = dictionary
        self._direction = direction
        self._communication = COMMUNICATION[direction] + number - 1
        self._mapping = MAPPING[direction] + number - 1
        self.cob_id = dictionary.entry(self._communication, 1)
        self.type = dictionary.entry(self._communication, 2)
        self.count = dictionary.entry(self._mapping, 0)
        self.mapped = dictionary.without_count(self._mapping)
        self.cob_id.on_check = self._check_cob_id
        self.type.on_check = self._check_type
        self.count.on_check = self._check_count
        for entry in self.mapped:
            entry.on_check = self._check_mapping
        self.cob_id.on_written = self.type.on_written = changed
        self._slots()

    @property
    def is_valid(self) -> bool:
        return cob.is_valid(self.cob_id.value)

    @property
    def can_id(self) -> int:
        return int(self.cob_id.value & cob.CAN_ID)

    @property
    def configured_can_id(self) -> int | None:
        return self.can_id if self.is_valid else None

    @property
    def allows_remote(self) -> bool:
        return not self.cob_id.value & cob.NO_RTR

    @property
    def mappings(self) -> list[int]:
        return [entry.value for entry in self.mapped[: self.count.value]]

    def further(self, subindex: int) -> Entry:
        return self._dictionary.assumed(self._communication, subindex)

    def active_slots(self) -> list[Slot]:
        """The mapped objects of a valid PDO. ValueError for an impossible mapping."""
        return self._slots() if self.is_valid else []

    def _check_cob_id(self, value: int) -> None:
        cob.check(value, self.cob_id.value)
        if cob.is_valid(value):
            self._check_combination(value, self.type.value)

    def _check_type(self, value: int) -> None:
        if value not in SYNCHRONOUS and value not in EVENT_DRIVEN:
            if value not in REMOTE_ONLY or self._direction is Direction.RECEIVE:
                raise SdoAbort(AbortCode.INVALID_VALUE)
            if self.is_valid:
                self._check_combination(self.cob_id.value, value)

    def _check_combination(self, cob_id: int, kind: int) -> None:
        """Refuse a valid PDO that nothing could ever trigger; CiA 301 does not mention this case."""
        if kind in REMOTE_ONLY and cob_id & cob.NO_RTR:
            raise SdoAbort(AbortCode.INVALID_VALUE)

    def _check_count(self, value: int) -> None:
        if self.is_valid:
            raise SdoAbort(AbortCode.UNSUPPORTED_ACCESS)
        if value > len(self.mapped):
            raise SdoAbort(AbortCode.PDO_LENGTH)
        mappings = [entry.value for entry in self.mapped[:value]]
        if not all(mappings):
            raise SdoAbort(AbortCode.NOT_MAPPABLE)
        resolve_all(self._dictionary, mappings, self._direction)

    def _check_mapping(self, value: int) -> None:
        if self.is_valid or self.count.value:
            raise SdoAbort(AbortCode.UNSUPPORTED_ACCESS)
        if value:  # 0 clears the mapping entry
            resolve(self._dictionary, value, self._direction)

    def _slots(self) -> list[Slot]:
        where = f"mapping {self._mapping:04X}h"
        if self.count.value > len(self.mapped):
            raise ValueError(f"{where} counts {self.count.value} objects, but has {len(self.mapped)}")
        try:
            return resolve_all(self._dictionary, self.mappings, self._direction)
        except SdoAbort as abort:
            raise ValueError(f"{where} is impossible: {abort}; correct the EDS") from abort


def struct_of(slots: Sequence[Slot]) -> struct.Struct | None:
    """The PDO as one `struct`; None if an object is not whole bytes of a known type."""
    letters = [
        datatypes.FORMATS.get(slot.data_type, "") if slot.entry is not None else f"{slot.bits // 8}x"
        for slot in slots
    ]
    if any(
        slot.data_type == datatypes.DataType.BOOLEAN or slot.data_type not in datatypes.FORMATS
        for slot in slots
    ):
        return None
    return struct.Struct("<" + "".join(letters))
