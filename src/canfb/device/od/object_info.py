"""What an index of the object dictionary holds."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class ObjectKind(IntEnum):
    """Object code (CiA 301, 7.4.3)."""

    DOMAIN = 0x02
    VAR = 0x07
    ARRAY = 0x08
    RECORD = 0x09


@dataclass(frozen=True, slots=True)
class ObjectInfo:
    """What an index holds: its name, its kind and its sub-indices in ascending order."""

    index: int
    name: str
    kind: ObjectKind
    subindices: tuple[int, ...]
