"""Which entries are stored parameters, the values that are kept of them, and how these come back."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from canfb.cia301 import datatypes
from canfb.cia301.codes import SdoAbort
from canfb.device.od.dictionary import Dictionary, Entry
from canfb.device.od.writes import TURNS, switched_off, turn
from canfb.device.storage.image import ImageError, ParameterGroup, Record

# The indices of each group (CiA 301, 7.5.2.13), without gaps between them.
RANGES = {
    ParameterGroup.COMMUNICATION: range(0x1000, 0x2000),
    ParameterGroup.MANUFACTURER: range(0x2000, 0x6000),
    ParameterGroup.APPLICATION: range(0x6000, 0xA000),
}
PARAMETER_INDICES = range(0x1000, 0xA000)

# Objects that SDO reads and writes, and that are commands.
NO_PARAMETERS = frozenset({0x1003, 0x1010, 0x1011})

_CAN_ID = 0x1FFFFFFF
_FLAGS_AND_ID = 0xFFFFFFFF


class KeptEntries:
    """The stored parameters of a device: entries with access rw, unless `leave_out` says otherwise; `keep`
    adds others.

    `written()` is called after each SDO write to one.
    """

    def __init__(self, dictionary: Dictionary, written: Callable[[], None]) -> None:
        self._dictionary = dictionary
        self._written = written
        self._saved_value: dict[tuple[int, int], Callable[[], Any]] = {}
        self._added: set[tuple[int, int]] = set()
        self._entries = {
            (entry.index, entry.subindex): entry
            for entry in dictionary
            if entry.access == "rw" and entry.index not in NO_PARAMETERS and entry.index in PARAMETER_INDICES
        }
        for entry in self._entries.values():
            entry.on_download = written

    def leave_out(self, index: int, subindex: int = 0) -> None:
        """This entry is not a parameter. KeyError without it."""
        self._entries.pop((index, subindex), None)
        self._dictionary.entry(index, subindex).on_download = None

    def keep(self, index: int, subindex: int = 0, *, saved: Callable[[], Any] | None = None) -> None:
        """Store this entry, or ``saved()`` in its place. KeyError without it."""
        place = index, subindex
        self._entries[place] = entry = self._dictionary.entry(*place)
        self._added.add(place)
        if saved is not None:
            self._saved_value[place] = saved
        if entry.access == "rw":
            entry.on_download = self._written

    def save_as(self, index: int, subindex: int, saved: Callable[[], Any]) -> None:
        """Save ``saved()`` in place of the value of this parameter."""
        self._saved_value[index, subindex] = saved

    def of(self, group: ParameterGroup) -> list[Entry]:
        return [entry for place, entry in sorted(self._entries.items()) if place[0] in RANGES[group]]

    def settings(self) -> list[Entry]:
        return [entry for place, entry in sorted(self._entries.items()) if place not in self._added]

    def records(self, group: ParameterGroup, node_id: int) -> list[Record]:
        saved = {place: value() for place, value in self._saved_value.items()}
        values = ((entry, saved.get((entry.index, entry.subindex), entry.value)) for entry in self.of(group))
        return [_record(entry, value, node_id) for entry, value in values if _is_within_limits(entry, value)]


def _record(entry: Entry, value: Any, node_id: int) -> Record:
    relative = _has_default_can_id(entry, value)
    if relative:
        value = (value - node_id) & _FLAGS_AND_ID
    return Record(entry.index, entry.subindex, relative, datatypes.encode(entry.data_type, value))


def restored_value(entry: Entry, record: Record, node_id: int) -> Any:
    if not record.relative:
        return entry.decode(record.data)
    value = (int.from_bytes(record.data, "little") + node_id) & _FLAGS_AND_ID
    return entry.decode(value.to_bytes(len(record.data), "little"))


def _is_within_limits(entry: Entry, value: Any) -> bool:
    try:
        entry.check_limits(value)
    except SdoAbort:
        return False
    return True


def _has_default_can_id(entry: Entry, value: Any) -> bool:
    """Whether a COB-ID follows the node-ID: at most its flags were changed."""
    if not entry.follows_node_id or entry.byte_length != 4:
        return False
    return not (int(value) ^ int(entry.default)) & _CAN_ID


Value = tuple[Entry, Any]


def restore(entries: KeptEntries, group: ParameterGroup, records: list[Record], node_id: int) -> None:
    """Write all records, or none and raise ImageError.

    Each value passes the checks of an SDO write, in the order that CiA 301 requires: first everything is
    switched off, at last come mappings, periods and COB-IDs. No `on_written` runs: the services read their
    parameters after a reset.
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
    known = {(entry.index, entry.subindex): entry for entry in entries.of(group)}
    for record in records:
        where = f"{record.index:04X}h:{record.subindex:02X}"
        entry = known.get((record.index, record.subindex))
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
    try:
        entry.check(value)
    except SdoAbort as abort:
        return f"{entry.index:04X}h:{entry.subindex:02X}: {abort}"
    entry.value = value
    return ""
