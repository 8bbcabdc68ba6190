"""The thread of a store: in order, nothing lost at the end, old or new whatever fails."""

from __future__ import annotations

import errno
import shutil
import threading
from collections.abc import Mapping
from pathlib import Path

import pytest

from canfb.device.storage.image import ParameterGroup as Group
from canfb.device.storage.storage import BackgroundStore, Changes, MemoryStore
from canfb.hosting.state_files import StateFiles, ThreadedStore

OLD: Changes = {Group.COMMUNICATION: b"old c" * 9, Group.MANUFACTURER: b"old table" * 20}
NEW: Changes = {Group.COMMUNICATION: b"new c" * 8, Group.MANUFACTURER: b"new table" * 21}


class HeldStore(MemoryStore):
    """Writes when it is let."""

    def __init__(self) -> None:
        super().__init__()
        self.let = threading.Event()
        self.threads: set[int] = set()

    def save(self, changes: Mapping[Group, bytes | None]) -> None:
        self.threads.add(threading.get_ident())
        assert self.let.wait(60.0)
        if not changes:
            raise OSError(errno.ENOSPC, "No space left on device")
        super().save(changes)


def all_ended(store: ThreadedStore, count: int) -> list[OSError | None]:
    """What has ended, with the load behind it as the sign that all has."""
    store.load()
    ended = store.ended()
    assert len(ended) == count
    return ended


def test_it_goes_on_and_keeps_the_order() -> None:
    held = HeldStore()
    with ThreadedStore(held) as store:
        assert isinstance(store, BackgroundStore)
        store.begin(OLD)
        store.begin({})
        store.begin(NEW)
        assert store.ended() == []
        held.let.set()
        first, second, third = all_ended(store, 3)
        assert (first, third) == (None, None)
        assert second is not None
        assert second.errno == errno.ENOSPC
        assert store.load() == NEW
        with pytest.raises(OSError, match="No space left"):
            store.save({})
    assert held.threads == held.threads - {threading.get_ident()}
    assert len(held.threads) == 1


def test_the_end_waits_for_what_was_begun(tmp_path: Path) -> None:
    with StateFiles(tmp_path) as files:
        with ThreadedStore(files) as store:
            store.begin(OLD)
            store.begin(NEW)
        assert files.load() == NEW
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("canfb-save")]


def test_a_folder_that_vanishes_and_comes_back(tmp_path: Path) -> None:
    folder = tmp_path / "state"
    with StateFiles(folder) as files, ThreadedStore(files) as store:
        store.save(OLD)
        shutil.rmtree(folder)
        store.begin(NEW)
        (failed,) = all_ended(store, 1)
        assert failed is not None
        assert failed.errno == errno.ENOENT
        folder.mkdir()
        store.begin(NEW)
        assert all_ended(store, 1) == [None]
        assert store.load() == NEW


def test_a_program_error_comes_out() -> None:
    class Wrong(MemoryStore):
        def save(self, changes: Mapping[Group, bytes | None]) -> None:
            raise KeyError("a mistake")

    with ThreadedStore(Wrong()) as store:
        store.begin(OLD)
        store.load()
        with pytest.raises(KeyError, match="a mistake"):
            store.ended()
