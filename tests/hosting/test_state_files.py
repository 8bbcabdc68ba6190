"""What is saved is there, whole and in order, whatever fails, by a thread too; who reads disturbs nobody."""

from __future__ import annotations

import contextlib
import errno
import itertools
import os
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from canfb.device.storage.kept import ParameterGroup as Group
from canfb.device.storage.storage import BackgroundStore, Changes, MemoryStore
from canfb.errors import CanfbError
from canfb.hosting import state_files
from canfb.hosting.state_files import PENDING, SavedParameters, StateDirError, StateFiles, ThreadedStore
from processes import Started

COMMUNICATION, APPLICATION, MANUFACTURER = Group.COMMUNICATION, Group.APPLICATION, Group.MANUFACTURER
OLD = {COMMUNICATION: b"old communication" * 5, APPLICATION: b"old a", MANUFACTURER: b"old table" * 20}
NEW = {COMMUNICATION: b"new communication" * 6, APPLICATION: b"new a", MANUFACTURER: b"new table" * 19}
LSS = {Group.LSS: b"node 40"}
ONE = {MANUFACTURER: b"one table" * 10}
CHANGES: dict[str, dict[Group, bytes | None]] = {
    "all are saved": dict(NEW),
    "all are forgotten": dict.fromkeys(NEW),
    "one is saved": dict(ONE),
    "one is forgotten": {APPLICATION: None},
    "one is saved and one forgotten": {APPLICATION: None, **ONE},
    "the node-ID is saved": dict(LSS),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "lib" / "canfb"


def test_a_second_store_is_refused_until_the_first_is_closed_or_its_process_has_ended(
    folder: Path, started: Started
) -> None:
    program = (
        "import signal\nfrom canfb.hosting.state_files import StateFiles\n"
        f"store = StateFiles({str(folder)!r})\nprint('has it')\nsignal.pause()\n"
    )
    process = started(sys.executable, "-W", "error", "-c", program)
    process.wait_for("^has it$")
    refused = pytest.raises(StateDirError, match=r"state_dir .*canfb cannot be used: another process, or")
    with refused:
        StateFiles(folder)
    process.send(signal.SIGKILL)
    process.wait()
    with StateFiles(folder) as store, refused:
        StateFiles(folder)
    store.close()
    with pytest.raises(OSError, match=r"canfb is closed"):
        store.save(NEW)
    StateFiles(folder).close()


def test_a_folder_that_was_made_again_belongs_to_who_takes_it_first(folder: Path) -> None:
    with StateFiles(folder) as store:
        shutil.rmtree(folder)
        folder.mkdir()
        store.save(OLD)
        with StateFiles(folder) as other:
            with pytest.raises(OSError, match="another process has taken it"):
                store.save(NEW)
            other.save(ONE)
            assert store.load() == OLD | ONE


def test_a_file_or_folder_in_its_place_is_a_clear_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder" / "lock").mkdir(parents=True)
    for folder in (tmp_path / "file", tmp_path / "file" / "deeper", tmp_path / "folder"):
        with pytest.raises(StateDirError, match=r"state_dir .* cannot be used: (File exists|(Not|Is) a dir)"):
            StateFiles(folder)
    assert issubclass(StateDirError, CanfbError)


def test_who_only_reads_takes_no_lock_and_makes_nothing(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader = SavedParameters(folder)
    assert reader.load() == {}
    with pytest.raises(OSError, match="for reading only"):
        reader.save(dict(OLD))
    assert list(tmp_path.iterdir()) == []
    with StateFiles(folder) as owner:
        owner.save(OLD)
        (folder / "lss.bin").mkdir()
        found = dict(reader.load())
        assert isinstance(found.pop(Group.LSS), OSError)
        assert found == OLD
    readings = iter([OLD | ONE, NEW, NEW])  # half of the old set and half of the new one are not what is kept
    monkeypatch.setattr(StateFiles, "load", lambda store: next(readings))
    assert reader.load() == NEW


def test_a_file_that_is_far_too_large_is_not_read_whole(folder: Path) -> None:
    with StateFiles(folder) as store:
        with (folder / "application.bin").open("wb") as file:
            file.truncate(1 << 33)
        error = store.load()[APPLICATION]
        assert isinstance(error, OSError)
        assert error.errno == errno.EFBIG


def pending(folder: Path) -> None:
    """Leave the folder as a crash does between the commit of NEW and its copying."""
    with StateFiles(folder) as store:
        store.save(OLD)
        in_its_way = folder / "communication.bin.new"
        in_its_way.mkdir()
        store.save(NEW)
        in_its_way.rmdir()
        assert (folder / PENDING).exists()


@pytest.mark.parametrize("changes", [LSS, {}])
def test_what_is_pending_holds_and_is_finished_by_the_next_save(folder: Path, changes: Changes) -> None:
    pending(folder)
    with StateFiles(folder) as store:
        assert store.load() == NEW
        store.save(changes)
        assert not (folder / PENDING).exists()
        assert store.load() == NEW | dict(changes)


def test_a_damaged_pending_change_is_an_error_of_all_parameters(folder: Path) -> None:
    pending(folder)
    whole = (folder / PENDING).read_bytes()
    for length in range(0, len(whole), 7):
        (folder / PENDING).write_bytes(whole[:length])
        with StateFiles(folder) as store:
            kept = store.load()
            assert set(kept) == set(OLD)
            assert all(isinstance(error, OSError) for error in kept.values())
    with StateFiles(folder) as store:
        store.save(ONE)  # no old group comes back beside it, and none becomes the default in silence
        assert store.load() == dict.fromkeys(OLD, b"") | ONE
    assert not (folder / PENDING).exists()


# A crash at any call, on a disk that keeps what was done, and on one that loses it.


class PowerFailure(BaseException):
    """The end of the process; no except clause of the program catches it."""


class Trouble:
    """Counts the calls of a disk and raises `error()` at call number `at`, from 1; 0 for never."""

    def __init__(self, at: int = 0, error: Callable[[], BaseException] = PowerFailure) -> None:
        self.calls = 0
        self._at = at
        self._error = error

    def step(self) -> None:
        self.calls += 1
        if self.calls == self._at:
            raise self._error()


class File:
    def __init__(self, data: bytes = b"") -> None:
        self.data = self.synchronised = data
        self.place = 0


class FakeDisk:
    """One folder in memory. A power failure leaves what `after` makes of it."""

    path = os.path
    stat = fstat = lambda disk, place: os.stat_result([0] * 10)  # always the same file

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.names = {str(folder): File()}
        self.lasting: dict[str, File] = {}
        self.trouble = Trouble()
        self._open: dict[int, File] = {}
        self._handles = itertools.count(100)

    def __getattr__(self, name: str) -> Any:
        assert name.startswith("O_"), f"the fake disk has no {name}"
        return getattr(os, name)

    def open(self, path: Path, flags: int, mode: int = 0) -> int:
        self.trouble.step()
        if str(path) not in self.names and not flags & os.O_CREAT:
            raise FileNotFoundError(path)
        file = self.names.setdefault(str(path), File())
        file.place = 0
        if flags & os.O_TRUNC:
            file.data = b""
        handle = next(self._handles)
        self._open[handle] = file
        return handle

    def read(self, handle: int, size: int) -> bytes:
        self.trouble.step()
        file = self._open[handle]
        part = file.data[file.place : file.place + min(size, 50)]
        file.place += len(part)
        return part

    def write(self, handle: int, data: bytes) -> int:
        self.trouble.step()
        part = bytes(data[:50])
        self._open[handle].data += part
        return len(part)

    def fsync(self, handle: int) -> None:
        self.trouble.step()
        file = self._open[handle]
        file.synchronised = file.data
        if file is self.names[str(self.folder)]:
            self.lasting = dict(self.names)

    def close(self, handle: int) -> None:
        self.trouble.step()
        del self._open[handle]

    def replace(self, source: Path, target: Path) -> None:
        self.trouble.step()
        self.names[str(target)] = self.names.pop(str(source))

    def unlink(self, path: Path) -> None:
        self.trouble.step()
        if self.names.pop(str(path), None) is None:
            raise FileNotFoundError(path)

    def after(self, *, names_kept: bool, data_kept: bool) -> FakeDisk:
        """The disk as the next start finds it."""
        disk = FakeDisk(self.folder)
        for name, file in (self.names if names_kept else self.lasting).items():
            disk.names[name] = disk.lasting[name] = File(file.data if data_kept else file.synchronised)
        return disk


def at_each_call(run: Callable[[Trouble], None], error: Callable[[], BaseException] = PowerFailure) -> None:
    """Once without trouble, and then with it at each call of the disk."""
    trouble = Trouble()
    run(trouble)
    assert trouble.calls > 3
    for at in range(1, trouble.calls + 1):
        run(Trouble(at, error))


@pytest.mark.parametrize("name", CHANGES)
@pytest.mark.parametrize("names_kept", [False, True])
@pytest.mark.parametrize("data_kept", [False, True])
@pytest.mark.parametrize("code", [None, errno.ENOSPC])
def test_after_a_power_failure_or_an_error_at_any_call_the_old_or_the_new_set_is_there(
    tmp_path: Path, name: str, names_kept: bool, data_kept: bool, code: int | None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """With an error of the disk the power fails behind it; what was acknowledged is there.

    Where the disk keeps names and data, this is a process that is killed.
    """
    after = {group: image for group, image in {**OLD, **CHANGES[name]}.items() if image is not None}
    finished = set()
    monkeypatch.setattr(state_files, "lock_file", lambda handle: None)

    def run(trouble: Trouble) -> None:
        disk = FakeDisk(tmp_path)
        monkeypatch.setattr(state_files, "os", disk)
        store = StateFiles(tmp_path)
        store.save(OLD)
        disk.trouble, saved = trouble, False
        with contextlib.suppress(PowerFailure, OSError):
            store.save(CHANGES[name])
            saved = True
        disk.trouble = Trouble()
        monkeypatch.setattr(state_files, "os", disk.after(names_kept=names_kept, data_kept=data_kept))
        restarted = StateFiles(tmp_path)
        kept = restarted.load()
        assert kept == after or (kept == OLD and not saved)
        finished.add(saved)
        restarted.save(ONE)
        assert restarted.load() == dict(kept) | ONE
        monkeypatch.setattr(state_files, "os", disk)
        if code is not None:
            assert store.load() == (after if saved else OLD)
            store.save(NEW | LSS)  # the disk has room again
            assert store.load() == NEW | LSS

    at_each_call(run, PowerFailure if code is None else lambda: OSError(code, os.strerror(code)))
    assert finished == {False, True}


class HeldStore(MemoryStore):
    """Writes when it is let; of no changes that the disk is full, and of LSS that there is a mistake."""

    def __init__(self) -> None:
        super().__init__()
        self.let = threading.Event()
        self.threads: set[int] = set()

    def save(self, changes: Mapping[Group, bytes | None]) -> None:
        self.threads.add(threading.get_ident())
        assert self.let.wait(60.0)
        if not changes:
            raise OSError(errno.ENOSPC, "No space left on device")
        if changes == LSS:
            raise KeyError("a mistake")
        super().save(changes)


def test_it_goes_on_and_keeps_the_order() -> None:
    held = HeldStore()
    with contextlib.closing(ThreadedStore(held)) as store:
        assert isinstance(store, BackgroundStore)
        store.begin(OLD)
        store.begin({})
        store.begin(NEW)
        assert store.ended() == []
        held.let.set()
        store.load()  # what stands before it has ended then
        first, second, third = store.ended()
        assert (first, third) == (None, None)
        assert second is not None
        assert second.errno == errno.ENOSPC
        assert store.load() == NEW
        with pytest.raises(OSError, match="No space left"):
            store.save({})
        store.begin(LSS)
        store.load()
        with pytest.raises(KeyError, match="a mistake"):
            store.ended()
    assert held.threads == held.threads - {threading.get_ident()}
    assert len(held.threads) == 1


def test_the_end_waits_for_what_was_begun(tmp_path: Path) -> None:
    with StateFiles(tmp_path) as files:
        with contextlib.closing(ThreadedStore(files)) as store:
            store.begin(OLD)
            store.begin(NEW)
        assert files.load() == NEW
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("canfb-save")]
