"""Stored values back into the dictionary, by the rules that hold for SDO."""

from __future__ import annotations

from typing import Any

from canfb.cia301.codes import SdoAbort
from canfb.device.od.entry import Entry
from canfb.device.od.writing_order import TURNS, switched_off, turn
from canfb.device.storage.image import ImageError, ParameterGroup, Record
from canfb.device.storage.kept import KeptEntries, restored_value

Value = tuple[Entry, Any]


def restore(entries: KeptEntries, group: ParameterGroup, records: list[Record], node_id: int) -> None:
    """Write all records, or none and raise ImageError.

    Each value passes the checks of an SDO write (`Entry.check`), in the order that CiA 301 requires
    of a master: first everything is switched off (PDOs not valid and without objects, no SYNC, no
    heartbeat to wait for), then comes the rest, at last mappings, periods and COB-IDs. Nothing acts on
    the values (`on_written`): the services read their parameters after a reset.
    """
    before = [(entry, entry.value) for entry in entries.of(group)]
    try:
        values = _values(entries, group, records, node_id)
        for entry, value in values:
            off = switched_off(entry, value)
            if off is not None:
                entry.value = off
        _write(values)
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
            raise ImageError(f"{where} is not a parameter of this device")
        try:
            values.append((entry, restored_value(entry, record, node_id)))
        except SdoAbort as abort:
            raise ImageError(f"{where}: {abort}") from None
    return values


def _write(values: list[Value]) -> None:
    """Write turn by turn; where one value waits for another, as a lower limit for the upper one, again."""
    for this in TURNS:
        waiting = [value for value in values if turn(value[0]) == this]
        while waiting:
            refused = [(value, reason) for value in waiting if (reason := _refusal(*value))]
            if len(refused) == len(waiting):
                raise ImageError(refused[0][1])
            waiting = [value for value, _ in refused]


def _refusal(entry: Entry, value: Any) -> str:
    """Write one value; why it is refused, or nothing."""
    try:
        entry.check(value)
    except SdoAbort as abort:
        return f"{entry.index:04X}h:{entry.subindex:02X}: {abort}"
    entry.value = value
    return ""
