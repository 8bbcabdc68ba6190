"""The objects that an EDS file describes, read once in a process for each content of the file.

Reading takes tens of milliseconds, copying a template less than one.
"""

from __future__ import annotations

from collections.abc import Mapping
from configparser import RawConfigParser
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from canopen import ObjectDictionary, import_od
from canopen.objectdictionary import ODArray, ODRecord, ODVariable

from canfb.cia301.codes import SdoAbort
from canfb.cia301.datatypes import DataType
from canfb.device.od import eds
from canfb.device.od.entry import Entry
from canfb.device.od.object_info import ObjectInfo, ObjectKind


@dataclass(frozen=True, slots=True)
class Template:
    """What a dictionary begins with. The entries are never given away: `fresh_entries` copies them."""

    entries: tuple[Entry, ...]
    objects: tuple[ObjectInfo, ...]
    dummies: frozenset[int]
    content: bytes

    def fresh_entries(self) -> list[Entry]:
        """Entries at their defaults, without hooks, not shared."""
        return [entry.fresh() for entry in self.entries]


def load(path: Path, node_id: int) -> Template:
    """The template of the file for this node-ID; a file that has changed is read again.

    Raises OSError when the file cannot be read, and ValueError that names the section when it describes
    something impossible.
    """
    try:
        return _template(path.read_bytes(), node_id)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


@dataclass(frozen=True, slots=True)
class _File:
    """A file as the parsers read it; never changed."""

    parser: RawConfigParser
    sections: Mapping[tuple[int, int], str]
    imported: ObjectDictionary


@lru_cache(maxsize=8)
def _file(content: bytes) -> _File:
    parser = eds.parse(content)
    try:
        # The node-ID does not matter: $NODEID is replaced by `eds.number`, not here.
        imported = import_od(eds.as_file(parser), 1)
    except Exception as error:
        raise ValueError(f"not a usable EDS: {error}") from error
    return _File(parser, eds.sections(parser), imported)


@lru_cache(maxsize=32)
def _template(content: bytes, node_id: int) -> Template:
    file = _file(content)
    entries: list[Entry] = []
    objects: list[ObjectInfo] = []
    for index in sorted(file.imported.indices):
        if index <= 0x1F:  # the dummies, which are not objects of the device
            continue
        thing = file.imported.indices[index]
        variables = _variables(thing)
        for variable in variables:
            section = file.sections[variable.index, variable.subindex]
            entries.append(_entry(file.parser, section, variable, node_id))
        subindices = tuple(variable.subindex for variable in variables)
        objects.append(ObjectInfo(index, str(thing.name), _kind(thing), subindices))
    return Template(tuple(entries), tuple(objects), eds.dummy_types(file.parser), content)


def _variables(thing: ODVariable | ODArray | ODRecord) -> list[ODVariable]:
    if isinstance(thing, ODVariable):
        return [thing]
    return [thing.subindices[subindex] for subindex in sorted(thing.subindices)]


def _kind(thing: ODVariable | ODArray | ODRecord) -> ObjectKind:
    if isinstance(thing, ODArray):
        return ObjectKind.ARRAY
    if isinstance(thing, ODRecord):
        return ObjectKind.RECORD
    return ObjectKind.DOMAIN if thing.data_type == DataType.DOMAIN else ObjectKind.VAR


def _entry(parser: RawConfigParser, section: str, variable: ODVariable, node_id: int) -> Entry:
    data_type = int(variable.data_type or 0)

    def number(option: str) -> Any:
        try:
            return eds.number(parser.get(section, option, fallback=""), data_type, node_id)
        except ValueError as error:
            raise ValueError(f"[{section}] {option}: {error}") from error

    try:
        entry = Entry(
            variable.index,
            variable.subindex,
            data_type,
            name=variable.name,
            access=variable.access_type,
            default=number("DefaultValue"),
            low=number("LowLimit"),
            high=number("HighLimit"),
            pdo_mappable=variable.pdo_mappable,
            follows_node_id="$NODEID" in parser.get(section, "DefaultValue", fallback="").upper(),
        )
        entry.encode()
        if entry.default is not None:
            entry.check_limits(entry.default)
    except (ValueError, SdoAbort) as error:
        raise ValueError(f"[{section}]: {error}") from error
    return entry
