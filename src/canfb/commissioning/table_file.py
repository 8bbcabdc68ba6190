"""Tables as files: YAML for people and version control, the exact bytes of object 2020:01 for programs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from canfb.commissioning.access import CommissioningError
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.correction import Correction, CorrectionTable


def as_yaml(used: Correction, meta: dict[str, Any]) -> str:
    """The set as YAML: what is known of it first, then the entries, in cycles."""
    table = used.table or CorrectionTable.identity()
    content = {
        "canfb_table": 1,
        **meta,
        "crc32": f"{table.crc32:08X}",
        "conditioning": conditioning_words(used.conditioning),
    }
    # Nine digits bring every REAL32 back exactly.
    entries = [float(f"{value:.9g}") for value in table.entries.tolist()]
    head: str = yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
    listed: str = yaml.safe_dump({"entries": entries}, default_flow_style=None, width=100)
    return (
        f"# Correction table of canfb: entries[n] is the phase, in cycles, at raw phase n/N.\n{head}{listed}"
    )


def conditioning_words(conditioning: Conditioning) -> dict[str, float]:
    """Object 2002:01..05 by name."""
    return {name: float(value) for name, value in conditioning.words.items()}


def read_table(path: str | Path) -> Correction:
    """A table file, YAML or the bytes of 2020:01 (which know no conditioning).

    CommissioningError, in one line, for anything else.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise CommissioningError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        return _from_yaml(data) if path.suffix in (".yaml", ".yml") else _from_bytes(data)
    except (ValueError, TypeError, yaml.YAMLError, RecursionError) as error:
        said = " ".join(str(error).split())[:200]
        raise CommissioningError(f"{path}: this is not a correction table: {said}") from None


def _from_bytes(data: bytes) -> Correction:
    return Correction(CorrectionTable.from_bytes(data), IDENTITY)


def _from_yaml(data: bytes) -> Correction:
    content = yaml.safe_load(data)
    if not isinstance(content, dict) or "entries" not in content:
        raise ValueError("a mapping with 'entries' is required")
    table = CorrectionTable(content["entries"])
    noted = content.get("crc32")
    if noted is not None and str(noted).upper() != f"{table.crc32:08X}":
        raise ValueError(f"its CRC is {table.crc32:08X}, but the file states {noted}: an entry was changed")
    words = content.get("conditioning") or {}
    unknown = set(words) - set(IDENTITY.words)
    if unknown:
        raise ValueError(f"unknown key {sorted(unknown)[0]!r} in conditioning")
    return Correction(table, Conditioning(**words))
