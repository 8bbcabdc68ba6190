"""A backup of a module: YAML, each parameter with its name and unit."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from canfb import objects as od
from canfb.files import read_bytes
from canfb.marked_yaml import MarkedYaml
from canfb.master.access import CommissioningError
from canfb.sdo.object_description import ObjectDescription, ObjectDescriptions, Place, numbered
from canfb.sdo.sdo_tasks import check_value, short_real
from canfb.signal.correction import CorrectionTable

FORMAT = 1
_COLUMN = 34


class NodeIdentity(NamedTuple):
    """1018h:01..04."""

    vendor: int
    product: int
    revision: int
    serial_number: int


@dataclass(frozen=True)
class Backup:
    """Its content.

    date           ISO 8601
    table          the bytes of 2020:01, empty for the identity
    not_restored   preset and offset
    unknown        parameters that this version does not know
    """

    node_id: int
    identity: NodeIdentity
    date: str
    version: str
    device_name: str
    values: Mapping[Place, Any]
    table: bytes = b""
    not_restored: Mapping[Place, Any] = field(default_factory=dict)
    unknown: tuple[str, ...] = ()


def backup_text(backup: Backup, described: ObjectDescriptions) -> str:
    """The backup as YAML. KeyError for a parameter that the EDS does not have."""
    entries = (
        {"crc32": f"{CorrectionTable.from_bytes(backup.table).crc32:08X}", "entries": _entries(backup.table)}
        if backup.table
        else None
    )
    head = {
        "canfb_backup": FORMAT,
        "date": backup.date,
        "canfb": backup.version,
        "device_name": backup.device_name,
        "node_id": backup.node_id,
        "identity": backup.identity._asdict(),
    }
    lines = ["# A backup of a canfb module, for `canfb backup restore`. Values are those of the objects."]
    lines += [_dumped(head).rstrip(), "parameters:", *_block(backup.values, described)]
    lines += ["not_restored:  # of the machine, for information: set the preset again after an exchange"]
    lines += _block(backup.not_restored, described)
    tail = _dumped({"table": entries}) if entries else "table: null  # the identity: no table\n"
    return "\n".join(lines) + "\n" + tail


def read_backup(path: Path, described: ObjectDescriptions, accept_unknown: bool = False) -> Backup:
    """CommissioningError, with line and key, for anything else."""
    data = read_bytes(path, CommissioningError)
    try:
        return _BackupReader(MarkedYaml(data), described, accept_unknown).backup()
    except ValueError as error:
        raise CommissioningError(f"{path}: {' '.join(str(error).split())[:300]}") from None


class _BackupReader:
    """ValueError, with line and key."""

    def __init__(self, marked: MarkedYaml, described: ObjectDescriptions, accept_unknown: bool) -> None:
        self._marked = marked
        self._described = described
        self._accept_unknown = accept_unknown
        self._unknown: list[str] = []

    def backup(self) -> Backup:
        content = self._marked.content
        if not isinstance(content, dict) or "canfb_backup" not in content:
            raise ValueError("this is not a backup of canfb: 'canfb_backup' is missing")
        if content["canfb_backup"] != FORMAT:
            raise self._wrong(
                f"this version reads backups of the format {FORMAT}, not {content['canfb_backup']!r}",
                "canfb_backup",
            )
        known = ("canfb_backup", "date", "canfb", "device_name", "node_id", "identity", "parameters")
        self._check_keys(content, (*known, "not_restored", "table"), known)
        return Backup(
            self._integer(content["node_id"], 127, "node_id", low=1),
            self._identity(content["identity"]),
            str(content["date"]),
            str(content["canfb"]),
            str(content["device_name"]),
            self._values(content["parameters"], "parameters"),
            self._table(content.get("table")),
            self._values(content.get("not_restored") or {}, "not_restored"),
            tuple(self._unknown),
        )

    def _identity(self, content: Any) -> NodeIdentity:
        self._check_keys(content, NodeIdentity._fields, NodeIdentity._fields, "identity")
        values = (self._integer(content[key], 0xFFFFFFFF, "identity", key) for key in NodeIdentity._fields)
        return NodeIdentity(*values)

    def _values(self, content: Any, section: str) -> dict[Place, Any]:
        if not isinstance(content, dict):
            raise self._wrong(f'must be a mapping of objects such as "2010:01", not {content!r}', section)
        values: dict[Place, Any] = {}
        for key, value in content.items():
            place = self._place(key, section)
            entry = self._described.find(*place)
            if entry is None and self._accept_unknown:
                self._unknown.append(str(key))
                continue
            if entry is None:
                raise self._wrong("this version has no such parameter; --force leaves it out", section, key)
            try:
                values[place] = check_value(entry.data_type, value, entry.low, entry.high)
            except ValueError as error:
                raise self._wrong(f"{entry.title} {error}", section, key) from None
        return values

    def _place(self, key: Any, section: str) -> Place:
        found = numbered(key) if isinstance(key, str) else None
        if found is None or found[1] is None:
            raise self._wrong(
                'unknown key: an object such as "2010:01", in quotes, is required', section, key
            )
        return found[0], found[1]

    def _table(self, content: Any) -> bytes:
        if content is None:
            return b""
        self._check_keys(content, ("crc32", "entries"), ("entries",), "table")
        try:
            table = CorrectionTable(content["entries"])
        except (ValueError, TypeError) as error:
            raise self._wrong(str(error), "table", "entries") from None
        noted = content.get("crc32")
        if noted is not None and str(noted).upper() != f"{table.crc32:08X}":
            raise self._wrong(
                f"{noted} is noted, and the CRC of the entries is {table.crc32:08X}: an entry was changed",
                "table",
                "crc32",
            )
        return table.to_bytes()

    def _check_keys(self, content: Any, known: tuple[str, ...], needed: tuple[str, ...], *above: str) -> None:
        if not isinstance(content, dict):
            raise self._wrong(f"must be a mapping with {', '.join(known)}, not {content!r}", *above)
        for key in content:
            if key not in known:
                raise self._wrong(f"unknown key; known are {', '.join(known)}", *above, key)
        for key in needed:
            if key not in content:
                raise self._wrong(f"{key!r} is missing", *above)

    def _integer(self, value: Any, high: int, *keys: str, low: int = 0) -> int:
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise self._wrong(f"must be a whole number {low}..{high}, not {value!r}", *keys)
        return value

    def _wrong(self, text: str, *keys: Any) -> ValueError:
        names = [str(key) for key in keys]
        return ValueError(f"line {self._marked.line(*names)}: {'.'.join(names)}{': ' * bool(names)}{text}")


def _block(values: Mapping[Place, Any], described: ObjectDescriptions) -> list[str]:
    lines, above = list[str](), ""
    for place in sorted(values):
        entry = described.find(*place)
        if entry is None:
            raise KeyError(f"{od.place_text(place)} is not in {described.path.name}")
        if entry.parent != above and not entry.name.startswith(entry.parent):
            lines.append(f"  # {entry.parent}")
        above = entry.parent
        text = f'  "{entry.number}": {_scalar(entry, values[place])}'
        unit = f", {entry.unit}" if entry.unit else ""
        lines.append(f"{text:{_COLUMN}}  # {entry.name}{unit}")
    return lines or ["  {}"]


def _scalar(entry: ObjectDescription, value: Any) -> str:
    if isinstance(value, bytes):
        return f'!!binary "{base64.b64encode(value).decode("ascii")}"'
    if isinstance(value, str):
        return _dumped(value, default_style='"', allow_unicode=False, width=float("inf")).strip()
    if isinstance(value, float):
        return _dumped(short_real(value, entry.data_type)).splitlines()[0]
    if entry.holds_bits:
        return f"0x{value:08X}"
    return _dumped(value).splitlines()[0]


def _entries(table: bytes) -> list[float]:
    values = CorrectionTable.from_bytes(table).entries.tolist()
    return [short_real(value) for value in values]


def _dumped(content: Any, **options: Any) -> str:
    return str(
        yaml.safe_dump(content, **{"sort_keys": False, "default_flow_style": None, "width": 100} | options)
    )
