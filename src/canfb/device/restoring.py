"""Stored values back into the dictionary, by the rules that hold for SDO."""

from __future__ import annotations

from typing import Any

from canfb.device import cob
from canfb.device.codes import SdoAbort
from canfb.device.entry import Entry
from canfb.device.image import ImageError, ParameterGroup, Record
from canfb.device.kept import KeptEntries, restored_value

_CYCLE_PERIOD, _SYNC, _TIME, _CONSUMERS = 0x1006, 0x1005, 0x1012, 0x1016
_MAPPINGS = (range(0x1600, 0x1800), range(0x1A00, 0x1C00))
_COMMUNICATIONS = (range(0x1400, 0x1600), range(0x1800, 0x1A00))
_SDO_CHANNELS = range(0x1200, 0x1300)
_EMCY = 0x1014
_TURNS = range(4)

Value = tuple[Entry, Any]


def restore(entries: KeptEntries, group: ParameterGroup, records: list[Record], node_id: int) -> None:
    """Write all records, or none and raise ImageError.

    Each value passes the checks of an SDO write, in the order that CiA 301 wants of a master: first
    everything is switched off (PDOs not valid and without objects, no SYNC, no heartbeat to wait
    for), then comes the rest, at last mappings, periods and COB-IDs. Hooks for what was written do
    not run: the services read their parameters after a reset.
    """
    before = [(entry, entry.value) for entry in entries.of(group)]
    try:
        values = _values(entries, group, records, node_id)
        for entry, _ in values:
            entry.value = _switched_off(entry)
        _write(entries, values)
    except ImageError:
        for entry, value in before:
            entry.value = value
        raise


def _values(entries: KeptEntries, group: ParameterGroup, records: list[Record], node_id: int) -> list[Value]:
    values: list[Value] = []
    for record in records:
        where = f"{record.index:04X}h:{record.subindex:02X}"
        entry = entries.find(group, record.index, record.subindex)
        if entry is None:
            raise ImageError(f"{where} is no parameter of this device")
        try:
            values.append((entry, restored_value(entry, record, node_id)))
        except SdoAbort as abort:
            raise ImageError(f"{where}: {abort}") from None
    return values


def _write(entries: KeptEntries, values: list[Value]) -> None:
    """Write turn by turn; where one value waits for another, as a lower limit for the upper one, again."""
    for turn in _TURNS:
        waiting = [value for value in values if _turn(value[0]) == turn]
        while waiting:
            refused = [(value, reason) for value in waiting if (reason := _refusal(entries, *value))]
            if len(refused) == len(waiting):
                raise ImageError(refused[0][1])
            waiting = [value for value, _ in refused]


def _refusal(entries: KeptEntries, entry: Entry, value: Any) -> str:
    """Write one value; why it is refused, or nothing."""
    try:
        entries.check(entry, value)
    except SdoAbort as abort:
        return f"{entry.index:04X}h:{entry.subindex:02X}: {abort}"
    entry.value = value
    return ""


def _turn(entry: Entry) -> int:
    if _is_mapping_count(entry):
        return 1
    if entry.index == _CYCLE_PERIOD:
        return 2
    return 3 if _is_cob_id(entry) else 0


def _switched_off(entry: Entry) -> Any:
    """The value that lets all others be written: nothing is used, no rule is broken."""
    if _is_mapping_count(entry) or entry.index in (_CYCLE_PERIOD, _CONSUMERS):
        return 0
    if not _is_cob_id(entry):
        return entry.value
    if entry.index == _SYNC:
        return entry.value & ~cob.GENERATE
    # Bit 31 of 1012h means that TIME is heard; that of all others, that the object does not exist.
    return entry.value & cob.CAN_ID if entry.index == _TIME else cob.NOT_VALID


def _is_mapping_count(entry: Entry) -> bool:
    return entry.subindex == 0 and any(entry.index in indices for indices in _MAPPINGS)


def _is_cob_id(entry: Entry) -> bool:
    if entry.index in (_SYNC, _TIME, _EMCY):
        return True
    if entry.index in _SDO_CHANNELS:
        return entry.subindex in (1, 2)
    return entry.subindex == 1 and any(entry.index in indices for indices in _COMMUNICATIONS)
