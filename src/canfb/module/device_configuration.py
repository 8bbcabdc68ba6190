"""The configuration of a module as a master loads it: every parameter that `save` keeps, as SDO writes."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

from canfb import objects as od
from canfb.cia301 import datatypes
from canfb.cia301.codes import SdoAbort
from canfb.device.od.dcf import Place
from canfb.device.od.dictionary import Entry
from canfb.device.od.writes import TURNS, Write, switched_off, turn
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig

OPENING: dict[Place, int] = {od.ENCODER_LOWEST_AMPLITUDE: 0}
"""Values that are always accepted and let others be written: the lower one of two amplitudes."""

LAST_PARAMETERS: tuple[Place, ...] = (od.ENCODER_FULL_SCALE, od.ENCODER_LOWEST_AMPLITUDE)
"""What follows the other parameters: any lower amplitude is accepted after the full scale."""

_PDOS = range(0x1400, 0x1C00)


class Setting(NamedTuple):
    """A parameter and its value."""

    entry: Entry
    value: Any

    @property
    def place(self) -> Place:
        """Index and sub-index."""
        return self.entry.index, self.entry.subindex


@dataclass(frozen=True)
class DeviceConfiguration:
    """All parameters of one module that SDO can write, whether they differ from a default or not.

    `table` is the content of 2020:01, empty for the identity. The preset (6003h, 6009h, 6509h) is not
    among them: it needs a position, and belongs to the machine.
    """

    node_id: int
    serial_number: int
    settings: tuple[Setting, ...]
    table: bytes

    @property
    def table_crc32(self) -> int:
        """What is written to 2020:03; 0 for the identity."""
        return zlib.crc32(self.table) if self.table else 0

    def values(self, *, with_table: bool = True) -> dict[Place, Any]:
        """The value of each object that a master writes, each once: what a DCF holds.

        The bytes of the table are left out unless `with_table`; 2020:03 is there in any case.
        """
        values = {setting.place: setting.value for setting in self.settings}
        if with_table and self.table:
            values[od.TABLE_STAGED] = self.table
        values[od.TABLE_ACTIVATE] = self.table_crc32
        return values

    def writes(self) -> list[Write]:
        """SDO writes that a module in Pre-operational takes one after the other, whatever it held before.

        First everything is switched off, PDOs before their mappings. Then come the parameters, the table
        with the conditioning, the numbers of mapped objects, 1006h, the COB-IDs, and at last 1020h, which
        any other write would clear.
        """
        off = {setting.place: value for setting in self.settings if (value := _off(setting)) is not None}
        first = [
            Setting(setting.entry, off[setting.place]) for setting in self.settings if setting.place in off
        ]
        rest = [setting for setting in self.settings if off.get(setting.place) != setting.value]
        rest.sort(key=lambda setting: _rank(setting.place))
        turns = [[_write(setting) for setting in rest if turn(setting.entry) == this] for this in TURNS]
        parameters, *later = turns
        return [
            *(_write(setting) for setting in first),
            *parameters,
            *self._table_writes(),
            *(write for writes in later for write in writes),
        ]

    def changed(self) -> dict[Place, Any]:
        """The parameters whose value is not that of a module as delivered."""
        dictionary = FeedbackModule(ModuleConfig(node_id=self.node_id)).dictionary
        return {
            setting.place: setting.value
            for setting in self.settings
            if setting.value != dictionary.entry(*setting.place).value
        }

    def refused_in_index_order(self) -> list[Place]:
        """What a module as delivered refuses when each object is written once, in ascending order.

        PDOs apart: every master knows how to write these.
        """
        module = FeedbackModule(ModuleConfig(node_id=self.node_id))
        module.start(0.0)
        pdos = [write for write in self.writes() if write.index in _PDOS]
        return [
            (write.index, write.subindex)
            for write in [*pdos, *self._ascending()]
            if not _is_taken(module, write)
        ]

    def _ascending(self) -> Iterator[Write]:
        entries = [_write(setting) for setting in self.settings if setting.entry.index not in _PDOS]
        yield from sorted([*entries, *self._table_writes()], key=lambda write: (write.index, write.subindex))

    def _table_writes(self) -> list[Write]:
        activate = Write(*od.TABLE_ACTIVATE, self.table_crc32.to_bytes(4, "little"))
        return [Write(*od.TABLE_STAGED, self.table), activate] if self.table else [activate]


def configuration_of(module: FeedbackModule) -> DeviceConfiguration:
    """What is in force in a module that was started."""
    table = module.chain.correction.table
    return _collect(module, Entry.current, b"" if table is None else table.to_bytes())


def configuration_read(
    node_id: int, read: Callable[[Entry], Any], serial_number: int, table: bytes
) -> DeviceConfiguration:
    """The configuration of another module, `node_id` 1..127, from its objects: `read(entry)` is a value."""
    template = FeedbackModule(ModuleConfig(node_id=node_id, serial_number=serial_number))
    return _collect(template, read, table)


def _collect(module: FeedbackModule, read: Callable[[Entry], Any], table: bytes) -> DeviceConfiguration:
    entries = module.node.storage.entries.settings()
    settings = tuple(Setting(entry, _as_sent(entry, read(entry))) for entry in entries)
    return DeviceConfiguration(
        module.node.node_id,
        int(module.dictionary.entry(*od.IDENTITY_SERIAL_NUMBER).value),
        tuple(setting for setting in settings if _is_within_limits(setting)),
        table,
    )


def _as_sent(entry: Entry, value: Any) -> Any:
    """The value as SDO carries it: a REAL32 has fewer digits than what a configuration gives."""
    return datatypes.decode(entry.data_type, datatypes.encode(entry.data_type, value))


def _is_within_limits(setting: Setting) -> bool:
    """A value beyond its own limits was not written, and cannot be."""
    try:
        setting.entry.check_limits(setting.value)
    except SdoAbort:
        return False
    return True


def _off(setting: Setting) -> Any:
    opening = OPENING.get(setting.place)
    return switched_off(setting.entry, setting.value) if opening is None else opening


def _rank(place: Place) -> int:
    return LAST_PARAMETERS.index(place) + 1 if place in LAST_PARAMETERS else 0


def _write(setting: Setting) -> Write:
    data = datatypes.encode(setting.entry.data_type, setting.value)
    return Write(setting.entry.index, setting.entry.subindex, data)


def _is_taken(module: FeedbackModule, write: Write) -> bool:
    try:
        module.dictionary.lookup(write.index, write.subindex).download(write.data)
    except SdoAbort:
        return False
    return True
