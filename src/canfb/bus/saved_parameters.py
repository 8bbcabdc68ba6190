"""Stored parameters in a folder, for who only reads them, also while a module is running on them."""

from __future__ import annotations

import errno
from collections.abc import Mapping
from pathlib import Path

from canfb.bus.state_files import Changes, StateFiles
from canfb.device.storage.image import ParameterGroup

_MOST_READINGS = 10


class SavedParameters(StateFiles):
    """A store to read from: it takes no lock and makes no folder; where there is none, nothing was saved."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self._lock = -1

    def load(self) -> Mapping[ParameterGroup, bytes | OSError]:
        """What is kept, by group. Read until two readings agree, as a save may be in progress."""
        before = super().load()
        for _ in range(_MOST_READINGS):
            again = super().load()
            if _content(again) == _content(before):
                break
            before = again
        return before

    def save(self, changes: Changes) -> None:
        """OSError: it is for reading."""
        raise OSError(errno.EROFS, f"{self.folder} is open for reading only")


def _content(kept: Mapping[ParameterGroup, bytes | OSError]) -> dict[ParameterGroup, bytes | str]:
    """What two readings are compared by: two errors are never equal as objects."""
    return {group: str(image) if isinstance(image, OSError) else image for group, image in kept.items()}
