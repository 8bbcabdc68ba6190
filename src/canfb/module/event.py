"""Events of a node: what a log of it says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum


class EventKind(StrEnum):
    """What has happened; the value is the name that programs read."""

    NMT = "nmt"
    SYNC_FOUND = "sync_found"
    SYNC_LOST = "sync_lost"
    FIRST_SAMPLE = "first_sample"
    POSITION = "position"
    SECOND_POSITION = "second_position"
    TABLE = "table"
    SAVED = "saved"
    SAVE_FAILED = "save_failed"
    FAULT = "fault"
    EMCY = "emcy"


DETAILS = frozenset({EventKind.FAULT, EventKind.EMCY})
"""What comes with single samples, or repeats what another event says."""


@dataclass(frozen=True, slots=True)
class Event:
    """Something that has happened in a node.

    kind    what it was
    time_s  when, seconds on the clock of `now`
    text    in words, without the node
    values  the same for programs: names and plain values
    """

    kind: EventKind
    time_s: float
    text: str
    values: Mapping[str, bool | float | int | str | list[str] | None] = field(default_factory=dict)
