"""A backup of a module in YAML, each parameter with its name and unit; and restoring it: write, verify, save,
or roll back."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import yaml

from canfb import objects as od
from canfb.cia301 import cob, datatypes
from canfb.cia301.codes import NmtCommand, NmtState
from canfb.cia301.datatypes import DataType
from canfb.device.od.dcf import Write
from canfb.errors import saying
from canfb.files import read_bytes
from canfb.marked_yaml import MarkedYaml
from canfb.master.access import CommissioningError, NodeAccess, nmt_state
from canfb.master.all_or_nothing import Guard, change, check_can_save, check_unlocked
from canfb.rows import Result, listed, those
from canfb.sdo.object_description import ObjectDescription, ObjectDescriptions, Place, numbered
from canfb.sdo.sdo_tasks import check_value, short_real
from canfb.sdo.tables import check_keys, table_in, wrong
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
    """The content of a backup.

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
    tail = "table: null  # the identity: no table\n"
    if backup.table:
        table = CorrectionTable.from_bytes(backup.table)
        values = [short_real(value) for value in table.entries.tolist()]
        tail = _dumped({"table": {"crc32": f"{table.crc32:08X}", "entries": values}})
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
    return "\n".join(lines) + "\n" + tail


def read_backup(path: Path, described: ObjectDescriptions, accept_unknown: bool = False) -> Backup:
    """Read a backup. CommissioningError, with line and key, for invalid content."""
    data = read_bytes(path, CommissioningError)
    with saying(CommissioningError, str(path), ValueError):
        return _BackupReader(MarkedYaml(data), described, accept_unknown).backup()


class _BackupReader:
    """Reads the YAML of a backup. ValueError, with line and key."""

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
            raise wrong(
                self._marked,
                f"this version reads backups of the format {FORMAT}, not {content['canfb_backup']!r}",
                "canfb_backup",
            )
        known = ("canfb_backup", "date", "canfb", "device_name", "node_id", "identity", "parameters")
        check_keys(self._marked, content, (*known, "not_restored", "table"), known)
        identity, fields = content["identity"], NodeIdentity._fields
        check_keys(self._marked, identity, fields, fields, "identity")
        numbers = (
            self._value(identity[key], DataType.UNSIGNED32, None, None, "", "identity", key) for key in fields
        )
        return Backup(
            self._value(content["node_id"], DataType.UNSIGNED8, 1, 127, "", "node_id"),
            NodeIdentity(*numbers),
            str(content["date"]),
            str(content["canfb"]),
            str(content["device_name"]),
            self._values(content["parameters"], "parameters"),
            self._table(content.get("table")),
            self._values(content.get("not_restored") or {}, "not_restored"),
            tuple(self._unknown),
        )

    def _values(self, content: Any, section: str) -> dict[Place, Any]:
        if not isinstance(content, dict):
            raise wrong(
                self._marked, f'must be a mapping of objects such as "2010:01", not {content!r}', section
            )
        values: dict[Place, Any] = {}
        for key, value in content.items():
            place = self._place(key, section)
            entry = self._described.find(*place)
            if entry is None and self._accept_unknown:
                self._unknown.append(str(key))
                continue
            if entry is None:
                raise wrong(
                    self._marked, "this version has no such parameter; --force leaves it out", section, key
                )
            values[place] = self._value(
                value, entry.data_type, entry.least, entry.most, f"{entry.title} ", section, key
            )
        return values

    def _place(self, key: Any, section: str) -> Place:
        found = numbered(key) if isinstance(key, str) else None
        if found is None or found[1] is None:
            raise wrong(
                self._marked, 'unknown key: an object such as "2010:01", in quotes, is required', section, key
            )
        return found[0], found[1]

    def _table(self, content: Any) -> bytes:
        if content is None:
            return b""
        check_keys(self._marked, content, ("crc32", "entries"), ("entries",), "table")
        return table_in(self._marked, content, "table").to_bytes()

    def _value(
        self, value: Any, data_type: int, low: float | None, high: float | None, said: str, *keys: Any
    ) -> Any:
        try:
            return check_value(data_type, value, low, high)
        except ValueError as error:
            raise wrong(self._marked, f"{said}{error}", *keys) from None


def _block(values: Mapping[Place, Any], described: ObjectDescriptions) -> list[str]:
    lines, above = list[str](), ""
    for place in sorted(values):
        entry = described.entry(*place)
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
    return f"0x{value:08X}" if entry.holds_bits else _dumped(value).splitlines()[0]


def _dumped(content: Any, **options: Any) -> str:
    return str(
        yaml.safe_dump(content, **{"sort_keys": False, "default_flow_style": None, "width": 100} | options)
    )


STORES = (od.STORE_ALL_PARAMETERS,)
MOST_SHOWN = 40
TABLE_WRITES = (od.TABLE_STAGED, od.TABLE_ACTIVATE)
TABLE = frozenset({od.TABLE_ACTIVATE, *od.CONDITIONING})
AFTER_PREOP = "; canfb node start ends the PRE-OPERATIONAL of --preop"


class Configured(Protocol):
    """:class:`canfb.module.device_configuration.DeviceConfiguration`."""

    def values(self) -> dict[Place, Any]:
        """The value of each object."""

    def writes(self) -> Sequence[Write]:
        """SDO writes, in order, for PRE-OPERATIONAL."""


@dataclass(frozen=True)
class Restored:
    """``changes``: values before, and in the backup; ``untouched``: objects that it lacks."""

    module: NodeAccess
    identity: NodeIdentity
    changes: dict[Place, tuple[Any, Any]]
    untouched: list[Place]
    saved_as: str | None


def restore_backup(
    module: NodeAccess,
    backup: Backup,
    read: Callable[[], Configured],
    made: Callable[[dict[Place, Any]], Configured],
    guard: Guard,
    *,
    keep: bool = False,
    force: bool = False,
    preop: bool = False,
    dry_run: bool = False,
) -> Restored:
    """Write, verify, save. CommissioningError if anything fails, after a roll-back.

    ``read`` gives the configuration of the module, or CanfbError. ``made`` gets its values, and gives the
    configuration with the values of the backup. ``keep``: save; ``force``: accept another major revision.
    """
    identity = _checked_identity(module, backup, force)
    before = read()
    after = made(before.values())
    foreign = sorted(backup.values.keys() - after.values().keys())
    if foreign and not force:
        raise CommissioningError(
            f"{listed([od.place_text(place) for place in foreign])}: no parameter that a restore writes; "
            "--force leaves it out"
        )
    changes = differences(before, after)
    if keep:
        check_can_save(module, STORES)

    def prove(configured: Configured, wrong: str) -> None:
        if changes:
            _write(module, configured, with_table=not TABLE.isdisjoint(changes))
            left = differences(read(), configured)
            if left:
                raise CommissioningError(f"{module.name}: {wrong}: {shown(left)}")

    saved_as = None
    if not dry_run:
        if changes:
            if module.read_known(od.WRITE_LOCK_MODE) == od.WriteLockMode.CODE:
                check_unlocked(module)  # before PRE-OPERATIONAL stops the samples
            _leave_operational(module, preop)
        saved_as = change(
            module,
            guard,
            lambda: prove(after, "not as written"),
            lambda: prove(before, "not as before"),
            what="what was before",
            undone=lambda: (
                f"the parameters and the table from before are in {module.name} again{AFTER_PREOP * preop}"
            ),
            keep=keep,
            stores=STORES,
        )
    untouched = sorted(before.values().keys() - backup.values.keys() - {od.TABLE_STAGED, od.TABLE_ACTIVATE})
    return Restored(module, identity, changes, untouched, saved_as)


def _checked_identity(module: NodeAccess, backup: Backup, force: bool) -> NodeIdentity:
    there = NodeIdentity(*(module.integer(*place, "I") for place in od.IDENTITY))
    if there[:2] != backup.identity[:2]:
        ours, theirs = (f"product {one.product} of vendor {one.vendor}" for one in (there, backup.identity))
        raise CommissioningError(
            f"{module.name} is {ours}, the backup is of {theirs}: it is for another device"
        )
    major, other = there.revision >> 16, backup.identity.revision >> 16
    if major != other and not force:
        raise CommissioningError(
            f"{module.name} has the major revision {major} (1018:03), the backup is of {other}: "
            "its objects may mean something else; --force restores what both have"
        )
    return there


def _leave_operational(module: NodeAccess, preop: bool) -> None:
    if preop:
        module.master.send(cob.NMT, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, module.node_id)))
    if nmt_state(module) is not NmtState.OPERATIONAL:
        return
    if preop:
        raise CommissioningError(f"{module.name} does not go to PRE-OPERATIONAL; nothing was written")
    raise CommissioningError(
        f"{module.name} is in OPERATIONAL: a restore switches its PDOs off meanwhile, and may move its "
        f"position. Stop the machine, and give --preop (or canfb node preop {module.node_id:#04x})"
    )


def _write(module: NodeAccess, configured: Configured, *, with_table: bool) -> None:
    """Write the configuration; without ``with_table`` no activation, which would reset the drift."""
    for one in configured.writes():
        place = one.index, one.subindex
        write = module.download_domain if place == od.TABLE_STAGED else module.write_bytes
        if with_table or place not in TABLE_WRITES:
            write(*place, one.data)


def differences(one: Configured, other: Configured) -> dict[Place, tuple[Any, Any]]:
    """The values of objects that differ; None: missing."""
    values, others = one.values(), other.values()
    # The CRC of the active table is compared instead of the staged data.
    places = sorted((values.keys() | others.keys()) - {od.TABLE_STAGED})
    pairs = {place: (values.get(place), others.get(place)) for place in places}
    # Two NaN count as equal.
    return {place: (one, to) for place, (one, to) in pairs.items() if one != to and (one == one or to == to)}


def shown(changes: dict[Place, tuple[Any, Any]]) -> str:
    texts = [
        f"{od.place_text(place)} is {there!r}, not {after!r}" for place, (there, after) in changes.items()
    ]
    return listed(texts, MOST_SHOWN)


def backup_result(backup: Backup, path: Path) -> Result:
    table = (
        f"table {zlib.crc32(backup.table):08X}h, {len(backup.table) // 4} entries"
        if backup.table
        else "no table"
    )
    node, serial = backup.node_id, backup.identity.serial_number
    what = f"module {node} ({node:02X}h), serial number {serial}"
    noted = ", ".join(od.place_text(place) for place, value in backup.not_restored.items() if value)
    lines = [
        f"{path}: {what}, {len(backup.values)} parameters, {table}",
        *those(
            (noted, f"note: {noted} (preset, offset) are in it, but not restored: set the preset again"),
        ),
    ]
    figures = {
        "file": str(path),
        "node_id": backup.node_id,
        "identity": backup.identity._asdict(),
        "parameters": len(backup.values),
        "table_crc32": f"{zlib.crc32(backup.table):08X}",
        "table_entries": len(backup.table) // 4,
    }
    return Result(figures, lines)


def restored_result(
    path: Path,
    backup: Backup,
    done: Restored,
    described: ObjectDescriptions,
    *,
    preop: bool,
    dry_run: bool,
) -> Result:
    count = f"{len(done.changes)} of {len(backup.values) + 1} values"
    written = f"{count} changed to those of {path}, verified by reading all of them back"
    nothing = f"all values are those of {path} already; nothing was written"
    lines = [
        *(_change(place, pair, described) for place, pair in done.changes.items()),
        *those(
            (dry_run, f"dry run: {path} would change {count} in {done.module.name}; nothing was written"),
            (not dry_run, f"{done.module.name}: {written if done.changes else nothing}"),
            (
                not dry_run,
                f"saved ({done.saved_as})" if done.saved_as else "not saved: --save keeps it (1010h)",
            ),
        ),
    ]
    changes = {
        od.place_text(place): [one.hex() if isinstance(one, bytes) else one for one in pair]
        for place, pair in done.changes.items()
    }
    figures = {
        "file": str(path),
        "node_id": done.module.node_id,
        "changed": changes,
        "written": bool(changes) and not dry_run,
        "saved_as": done.saved_as,
        "serial_number": done.identity.serial_number,
        "serial_number_of_backup": backup.identity.serial_number,
        "unknown": list(backup.unknown),
        "untouched": [od.place_text(place) for place in done.untouched],
    }
    return Result(figures, lines + _notes(backup, done, preop=preop and bool(changes) and not dry_run))


def _notes(backup: Backup, done: Restored, *, preop: bool) -> list[str]:
    ours, theirs = done.identity.serial_number, backup.identity.serial_number
    untouched = ", ".join(od.place_text(place) for place in done.untouched)
    notes = those(
        (ours != theirs, f"the backup is of serial number {theirs}, this module has {ours}"),
        (
            backup.unknown,
            f"left out, as this version does not know them: {', '.join(backup.unknown)}",
        ),
        (untouched, f"not in the backup, unchanged: {untouched}"),
        (preop, f"the node is in PRE-OPERATIONAL: canfb node start {done.module.node_id:#04x}"),
    )
    return [f"note: {note}" for note in notes]


def _change(place: Place, pair: tuple[Any, Any], described: ObjectDescriptions) -> str:
    if place == od.TABLE_ACTIVATE:
        before, after = (f"{value:08X}h" if value else "none" for value in pair)
        return f"  correction table: {before} -> {after}"
    entry = described.entry(*place)
    real = entry.data_type in datatypes.FLOATS
    before, after = (f"{short_real(value):.9g}" if real else str(value) for value in pair)
    unit = f" {entry.unit}" if entry.unit else ""
    return f"  {entry.number} {entry.title}: {before} -> {after}{unit}"
