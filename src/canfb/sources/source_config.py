"""``source:`` of a module in the configuration: where its samples come from, if not from the ADC PDO."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from canfb.sources.protocol import Source
from canfb.sources.surroundings import Surroundings


@dataclass(frozen=True, kw_only=True)
class SourceConfig:
    """One source, as the configuration has it; each kind is a class of its own, in a file of its own.

    Its fields are the keys of the YAML, but those with ``metadata={"key": False}``; one that holds a list
    has ``metadata={"list": True}``. ValueError for a wrong value, with the name of the key before all.

    kind   the word after ``kind:``: which source it is
    """

    kind: str = ""

    def __post_init__(self) -> None:
        own_kind = type(self).kind
        if self.kind != own_kind:
            raise ValueError(f"kind must be {own_kind} here, not {self.kind!r}")

    @property
    def title(self) -> str:
        """What it is, for messages."""
        return f"source {self.kind!r}"

    def of_module(self, keys: Mapping[str, Any]) -> SourceConfig:
        """The same, for a module with these keys in its configuration: those alone that are there."""
        return self

    def check_machine(self) -> None:
        """ConfigError, which names the key, for what cannot be on this machine. Nothing is opened."""

    def open(self, surroundings: Surroundings) -> Source:
        """The source. CanfbError, in one line, for one that cannot be used."""
        raise NotImplementedError


def column(name: str, value: object) -> None:
    """ValueError unless ``value`` is the name or the number of a column."""
    if isinstance(value, bool) or not isinstance(value, (str, int)) or value == "":
        raise ValueError(f"{name} must be a name or a number from 0, not {value!r}")
