"""All parameters of a module, as SDO writes in an order that CiA 301 allows, and as files for a master."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from canfb import objects as od
from canfb.cia301 import datatypes
from canfb.device.od.dcf import TURNS, Place, Reals, Write, dcf_text, encode_concise, switched_off, turn
from canfb.device.od.dictionary import Dictionary, Entry, is_accepted
from canfb.device.storage.kept import has_default_can_id
from canfb.eds_files import eds_path
from canfb.errors import CanfbError
from canfb.files import write_whole
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.module.parameters import EDS

# Values that are always accepted, so that others can be written: 0 for the lowest amplitude.
OPENING: dict[Place, int] = {od.ENCODER_LOWEST_AMPLITUDE: 0}
# Written after the other parameters, in this order: after the full scale, any lowest amplitude is accepted
# until the highest one is written.
LAST_PARAMETERS: tuple[Place, ...] = (
    od.ENCODER_FULL_SCALE,
    od.ENCODER_LOWEST_AMPLITUDE,
    od.ENCODER_HIGHEST_AMPLITUDE,
)

_PDOS = range(0x1400, 0x1C00)


class Setting(NamedTuple):
    """A parameter and its value."""

    entry: Entry
    value: Any

    @property
    def place(self) -> Place:
        return self.entry.index, self.entry.subindex

    @property
    def off(self) -> Any:
        """The value at which other parameters can be written; None: it blocks none."""
        opening = OPENING.get(self.place)
        return switched_off(self.entry, self.value) if opening is None else opening

    @property
    def rank(self) -> int:
        return LAST_PARAMETERS.index(self.place) + 1 if self.place in LAST_PARAMETERS else 0

    def write(self, value: Any) -> Write:
        return Write(*self.place, datatypes.encode(self.entry.data_type, value))


@dataclass(frozen=True)
class DeviceConfiguration:
    """All parameters of one module that SDO can write, including those at their default.

    `table` is the content of 2020:01, empty for the identity. The preset, which needs a position, is not
    included.
    """

    node_id: int
    serial_number: int
    settings: tuple[Setting, ...]
    table: bytes

    @property
    def table_crc32(self) -> int:
        return zlib.crc32(self.table)

    def values(self, *, with_table: bool = True) -> dict[Place, Any]:
        """The values for a DCF: the bytes of the table only `with_table`, 2020:03 in any case."""
        values = {setting.place: setting.value for setting in self.settings}
        if with_table and self.table:
            values[od.TABLE_STAGED] = self.table
        values[od.TABLE_ACTIVATE] = self.table_crc32
        return values

    def writes(self) -> list[Write]:
        """SDO writes in an order that a module in Pre-operational accepts, with any previous values.

        First all is switched off; then the parameters, the table with the conditioning, the numbers of
        mapped objects, 1006h, the COB-IDs, and last 1020h, which any other write would clear.
        """
        first = [setting.write(setting.off) for setting in self.settings if setting.off is not None]
        rest = [setting for setting in self.settings if setting.off != setting.value]
        rest.sort(key=lambda setting: (TURNS.index(turn(setting.entry)), setting.rank))
        parameters = [setting.write(setting.value) for setting in rest if turn(setting.entry) == TURNS[0]]
        later = [setting.write(setting.value) for setting in rest if turn(setting.entry) != TURNS[0]]
        return [*first, *parameters, *self._table_writes(), *later]

    def changed(self) -> dict[Place, Any]:
        dictionary = FeedbackModule(ModuleConfig.factory(self.node_id)).dictionary
        return {
            setting.place: setting.value
            for setting in self.settings
            if setting.value != dictionary.entry(*setting.place).value
        }

    def refused_in_index_order(self) -> list[Place]:
        """Objects that factory defaults refuse, each written once: PDOs first, the rest ascending."""
        module = FeedbackModule(ModuleConfig.factory(self.node_id))
        module.start(0.0)
        pdos = [write for write in self.writes() if write.index in _PDOS]
        writes = [setting.write(setting.value) for setting in self.settings]
        others = [write for write in [*writes, *self._table_writes()] if write.index not in _PDOS]
        others.sort(key=lambda write: (write.index, write.subindex))
        entry = module.dictionary.entry
        return [
            (write.index, write.subindex)
            for write in [*pdos, *others]
            if not is_accepted(entry(write.index, write.subindex).download, write.data)
        ]

    def _table_writes(self) -> list[Write]:
        activate = Write(*od.TABLE_ACTIVATE, self.table_crc32.to_bytes(4, "little"))
        return [Write(*od.TABLE_STAGED, self.table), activate] if self.table else [activate]


def configuration_of(module: FeedbackModule) -> DeviceConfiguration:
    table = module.chain.correction.table
    return _collect(module, Entry.current, b"" if table is None else table.to_bytes())


def configuration_read(
    node_id: int, read: Callable[[Entry], Any], serial_number: int, table: bytes
) -> DeviceConfiguration:
    """The configuration of the module `node_id`, 1..127, whose values are `read(entry)`."""
    template = FeedbackModule(ModuleConfig.factory(node_id, serial_number))
    return _collect(template, read, table)


def _collect(module: FeedbackModule, read: Callable[[Entry], Any], table: bytes) -> DeviceConfiguration:
    settings = tuple(  # rounded to the digits of a REAL32
        Setting(one, datatypes.decode(one.data_type, datatypes.encode(one.data_type, read(one))))
        for one in module.storage.entries.settings()
    )
    return DeviceConfiguration(
        module.node_id,
        int(module.dictionary.entry(*od.IDENTITY_SERIAL_NUMBER).value),
        # Without values beyond their own limits, which no master can write.
        tuple(setting for setting in settings if is_accepted(setting.entry.check_limits, setting.value)),
        table,
    )


IDENTITY = (od.DEVICE_TYPE, od.IDENTITY_VENDOR_ID, od.IDENTITY_PRODUCT_CODE)  # identifies a module of canfb
ACTIVE_CONDITIONING = struct.Struct(f"<{len(od.CONDITIONING)}f")
CHANGED = "the table changed while it was read; try again"


class Objects(Protocol):
    """A node on a bus; CanfbError if an object cannot be read."""

    @property
    def node_id(self) -> int:
        """1..127."""

    @property
    def name(self) -> str:
        """For messages."""

    def read(self, index: int, subindex: int, layout: str) -> int | float:
        """A number, ``layout`` as in struct."""

    def upload_domain(self, index: int, subindex: int) -> bytes:
        """The bytes of any object."""


def read_configuration(objects: Objects) -> DeviceConfiguration:
    """The configuration of a module on a bus. CanfbError if it cannot be read, or is not of canfb.

    Table and conditioning are those in force: between an upload and its activation, 2002h may belong to
    another table.
    """
    dictionary = Dictionary.load(eds_path(EDS), objects.node_id)
    for place in IDENTITY:
        entry = dictionary.entry(*place)
        found = _read(objects, entry)
        if found != entry.value:
            what = f"{place[0]:04X}:{place[1]:02X} is {found:X}h, not {entry.value:X}h"
            raise CanfbError(f"{objects.name} is not a feedback module of canfb: {what}")
    serial_number = int(_read(objects, dictionary.entry(*od.IDENTITY_SERIAL_NUMBER)))
    conditioning = objects.upload_domain(*od.TABLE_ACTIVE_CONDITIONING)
    table = _read_table(objects, dictionary)
    if objects.upload_domain(*od.TABLE_ACTIVE_CONDITIONING) != conditioning:
        raise CanfbError(f"{objects.name}: {CHANGED}")
    if len(conditioning) != ACTIVE_CONDITIONING.size:
        raise CanfbError(f"{objects.name}: 2020:07 has {len(conditioning)} bytes: another version of canfb")
    in_force = dict(zip(od.CONDITIONING, ACTIVE_CONDITIONING.unpack(conditioning), strict=True))

    def value(entry: Entry) -> Any:
        place = od.Multiplexer(entry.index, entry.subindex)
        return in_force[place] if place in in_force else _read(objects, entry)

    return configuration_read(objects.node_id, value, serial_number, table)


def _read(objects: Objects, entry: Entry) -> Any:
    letter = datatypes.FORMATS.get(entry.data_type)
    if letter is None:
        return entry.decode(objects.upload_domain(entry.index, entry.subindex))
    return objects.read(entry.index, entry.subindex, letter)


def _read_table(objects: Objects, dictionary: Dictionary) -> bytes:
    crc32 = _read(objects, dictionary.entry(*od.TABLE_ACTIVE_CRC))
    if not crc32:
        return b""
    table = objects.upload_domain(*od.TABLE_STAGED)
    if zlib.crc32(table) != crc32:
        raise CanfbError(f"{objects.name}: {CHANGED}")
    return table


# Also kept by `save`, but no master can write them back: a preset needs a valid position at standstill.
OF_THE_MACHINE = (od.PRESET_VALUE, od.HIGH_PRECISION_PRESET, od.OFFSET_VALUE)


def backup_values(configuration: DeviceConfiguration) -> dict[Place, Any]:
    return {setting.place: setting.value for setting in configuration.settings}


def restored_configuration(
    values: Mapping[Place, Any], before: Mapping[Place, Any], table: bytes, made_for: int, node_id: int
) -> DeviceConfiguration:
    """The configuration for `node_id` from the `values` of a backup `made_for` another node, both 1..127.

    Values that the backup lacks stay as `before`.
    """
    merged = dict(before) | moved_values(values, made_for, node_id)
    return configuration_read(
        node_id, lambda entry: merged[entry.index, entry.subindex], serial_number=0, table=table
    )  # SDO does not write the serial number


def moved_values(values: Mapping[Place, Any], old: int, new: int) -> dict[Place, Any]:
    """`values` with the CAN-IDs that are defaults of node `old` replaced by those of node `new`."""
    dictionary = Dictionary.load(eds_path(EDS), old)
    moved = dict(values)
    for place, value in values.items():
        entry = dictionary.find(*place)
        if entry is not None and has_default_can_id(entry, value):
            moved[place] = value + new - old
    return moved


@dataclass(frozen=True)
class ConfigurationFiles:
    """The files of a configuration.

    out            path of the DCF; None: module-20h.dcf, with the node-ID of the module
    concise        path of the concise form (1F22h), None: not written
    table_inline   the table is in the DCF, too
    reals          format of REAL32
    node_name      NodeName of the DCF, empty: module_20h
    bus_words      settings for python-can: bitrate and channel
    """

    configuration: DeviceConfiguration
    out: Path | None = None
    concise: Path | None = None
    table_inline: bool = True
    reals: Reals = Reals.DECIMAL
    node_name: str = ""
    bus_words: Mapping[str, Any] | None = None

    @property
    def path(self) -> Path:
        return self.out or Path(f"module-{self.configuration.node_id:02X}h.dcf")

    @property
    def table_path(self) -> Path | None:
        return self.path.with_suffix(".table.bin") if self.configuration.table else None

    def write(self, date: str, time: str) -> None:
        """Write the files; ``date`` mm-dd-yyyy, ``time`` hh:mmAM (CiA 306). CanfbError."""
        write_whole(self.path, self._text(date, time).encode("ascii", errors="replace"))
        if self.table_path is not None:
            write_whole(self.table_path, self.configuration.table)
        if self.concise is not None:
            write_whole(self.concise, encode_concise(self.configuration.writes()))

    def _text(self, date: str, time: str) -> str:
        configuration, words = self.configuration, self.bus_words or {}
        bit_rate, channel = words.get("bitrate"), words.get("channel")
        return dcf_text(
            eds_path(EDS),
            configuration.values(with_table=self.table_inline),
            file_name=self.path.name,
            description=f"Configuration of a drive feedback module, node-ID {configuration.node_id}",
            date=date,
            time=time,
            node_id=configuration.node_id,
            node_name=self.node_name or f"module_{configuration.node_id:02X}h",
            bit_rate_kbit_s=round(bit_rate / 1000) if isinstance(bit_rate, int) else None,
            network_name="CANopen" if channel is None else str(channel),
            serial_number=configuration.serial_number,
            reals=self.reals,
            files=None if self.table_path is None else {od.TABLE_STAGED: self.table_path.name},
        )

    def summary(self) -> dict[str, Any]:
        configuration = self.configuration
        return {
            "dcf": str(self.path),
            "concise": None if self.concise is None else str(self.concise),
            "table": None if self.table_path is None else str(self.table_path),
            "node_id": configuration.node_id,
            "serial_number": configuration.serial_number,
            "parameters": len(configuration.settings),
            "changed": {od.place_text(place): value for place, value in configuration.changed().items()},
            "table_crc32": f"{configuration.table_crc32:08X}",
            "table_entries": len(configuration.table) // 4,
            "concise_writes": len(configuration.writes()),
            "refused_in_index_order": list(map(od.place_text, configuration.refused_in_index_order())),
        }

    def lines(self) -> list[str]:
        configuration, changed = self.configuration, self.configuration.changed()
        node_id = configuration.node_id
        others = f"not at factory defaults: {place_names(list(changed))}" if changed else "factory defaults"
        count = len(configuration.settings)
        lines = [f"{self.path}: node {node_id} ({node_id:02X}h), {count} parameters; {others}"]
        if self.table_path is not None:
            size, crc32 = len(configuration.table) // 4, configuration.table_crc32
            lines.append(f"{self.table_path}: correction table, {size} entries, {crc32:08X}")
        if self.concise is not None:
            lines.append(f"{self.concise}: the concise form, {len(configuration.writes())} writes")
        return lines


def place_names(places: list[Place]) -> str:
    """For example "1017:00, 2010:03"."""
    return ", ".join(od.place_text(place) for place in places)
