"""What ``canfb backup`` and ``canfb restore`` say, for people and for programs."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

from canfb import objects as od
from canfb.backup.backup_file import Backup
from canfb.backup.backup_restoring import Restored
from canfb.cia301 import datatypes
from canfb.rows import Result
from canfb.sdo.object_description import ObjectDescriptions, Place
from canfb.sdo.object_values import short_real


def backup_result(backup: Backup, path: Path) -> Result:
    """What a backup has."""
    table = f"table {_crc32(backup):08X}h, {len(backup.table) // 4} entries" if backup.table else "no table"
    node, serial = backup.node_id, backup.identity.serial_number
    what = f"module {node} ({node:02X}h), serial number {serial}"
    lines = [f"{path}: {what}, {len(backup.values)} parameters, {table}"]
    noted = [od.place_text(place) for place, value in backup.not_restored.items() if value]
    if noted:
        lines.append(
            f"note: {', '.join(noted)} (preset, offset) are in it, but not restored: set the preset again"
        )
    figures = {
        "file": str(path),
        "node_id": backup.node_id,
        "identity": backup.identity._asdict(),
        "parameters": len(backup.values),
        "table_crc32": f"{_crc32(backup):08X}",
        "table_entries": len(backup.table) // 4,
    }
    return Result(figures, lines)


def restored_result(path: Path, backup: Backup, done: Restored, described: ObjectDescriptions) -> Result:
    """What changed in the module, and what the operator should know."""
    name, wishes = done.module.name, done.wishes
    lines = [_change(place, pair, described) for place, pair in done.changes.items()]
    count = f"{len(done.changes)} of {len(backup.values) + 1} values"
    if wishes.dry_run:
        lines.append(f"dry run: {path} would change {count} in {name}; nothing was written")
    elif done.changes:
        lines.append(f"{name}: {count} changed to those of {path}, proven by reading all of them back")
    else:
        lines.append(f"{name}: all values are those of {path} already; nothing was written")
    if not wishes.dry_run:
        lines.append(f"saved ({done.saved_as})" if done.saved_as else "not saved: --save keeps it (1010h)")
    changes = {od.place_text(place): _plain(list(pair)) for place, pair in done.changes.items()}
    figures = {
        "file": str(path),
        "node_id": done.module.node_id,
        "changed": changes,
        "written": bool(changes) and not done.wishes.dry_run,
        "saved_as": done.saved_as,
        "serial_number": done.identity.serial_number,
        "serial_number_of_backup": backup.identity.serial_number,
        "unknown": list(backup.unknown),
        "untouched": [od.place_text(place) for place in done.untouched],
    }
    return Result(figures, lines + _notes(backup, done))


def _notes(backup: Backup, done: Restored) -> list[str]:
    ours, theirs = done.identity.serial_number, backup.identity.serial_number
    notes = []
    if ours != theirs:
        notes.append(f"the backup is of serial number {theirs}, this module has {ours}")
    if backup.unknown:
        notes.append(f"left out, as this version does not know them: {', '.join(backup.unknown)}")
    if done.untouched:
        places = ", ".join(od.place_text(place) for place in done.untouched)
        notes.append(f"not in the backup, and as before: {places}")
    if done.wishes.preop and done.changes and not done.wishes.dry_run:
        notes.append(f"the node is in PRE-OPERATIONAL: canfb nmt start {done.module.node_id:#04x}")
    return [f"note: {note}" for note in notes]


def _change(place: Place, pair: tuple[Any, Any], described: ObjectDescriptions) -> str:
    if place == od.TABLE_ACTIVATE:
        before, after = (f"{value:08X}h" if value else "none" for value in pair)
        return f"  correction table: {before} -> {after}"
    entry = described.find(*place)
    if entry is None:
        return f"  {od.place_text(place)}: {pair[0]!r} -> {pair[1]!r}"
    real = entry.data_type in datatypes.FLOATS
    before, after = (f"{short_real(value):g}" if real else str(value) for value in pair)
    unit = f" {entry.unit}" if entry.unit else ""
    return f"  {entry.number} {entry.title}: {before} -> {after}{unit}"


def _plain(values: list[Any]) -> list[Any]:
    return [value.hex() if isinstance(value, bytes) else value for value in values]


def _crc32(backup: Backup) -> int:
    return zlib.crc32(backup.table) if backup.table else 0
