"""The kinds of sources: every ``*_source.py`` of this folder is one, and nothing else knows of it."""

from __future__ import annotations

import importlib
import pkgutil

import canfb.sources
from canfb.sources.source_config import SourceConfig

ENDING = "_source"


def source_kinds() -> dict[str, type[SourceConfig]]:
    """The class for each word after ``kind:``, in alphabetical order."""
    names = (name for _, name, _ in pkgutil.iter_modules(canfb.sources.__path__) if name.endswith(ENDING))
    found = (_kind_of(name) for name in names)
    return {kind.kind: kind for kind in sorted(found, key=lambda kind: kind.kind)}


def _kind_of(name: str) -> type[SourceConfig]:
    """The one subclass of SourceConfig that the file defines."""
    module = importlib.import_module(f"{canfb.sources.__name__}.{name}")
    (kind,) = (
        thing
        for thing in vars(module).values()
        if isinstance(thing, type) and issubclass(thing, SourceConfig) and thing.__module__ == module.__name__
    )
    return kind
