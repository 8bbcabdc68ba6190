"""Stored parameters as files: one for each group in a folder, intact after a crash at any instant.

Each is written to a temporary file, which is renamed. Before that, all groups of a change are written to one
file, ``pending.bin``, which takes effect by its rename.
"""

from __future__ import annotations

import contextlib
import errno
import os
import struct
import sys
import threading
import zlib
from collections import deque
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from canfb.bus.sdo_channel import lock_file
from canfb.device.storage.kept import ParameterGroup
from canfb.device.storage.storage import PARAMETERS, Changes, Store
from canfb.errors import CanfbError, saying

LARGEST_FILE = 1 << 20  # bytes; stored parameters need some ten thousand
PENDING = "pending.bin"
LOCK = "lock"
_MOST_READINGS = 10

_MAGIC = b"CANFBSET"
_HEADER = struct.Struct("<8sI")
_PART = struct.Struct("<BBI")  # group, 1: stored or 0: deleted, bytes of the image
_CRC = struct.Struct("<I")


class StateDirError(CanfbError):
    """A state_dir that cannot be used."""


class StateFiles(contextlib.AbstractContextManager["StateFiles"]):
    """What 1010h and LSS save, as files in a ``folder``, created if missing.

    One process owns it until :meth:`close`. StateDirError if another owns it or it cannot be written.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        with saying(StateDirError, f"state_dir {self.folder} cannot be used", OSError):
            if not self.folder.is_dir():
                os.makedirs(self.folder)
                _sync_folder(self.folder.parent)
            self._lock = os.open(self.folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            lock_file(self._lock)
        except OSError as error:
            os.close(self._lock)
            in_use = error.errno in (errno.EWOULDBLOCK, errno.EACCES)
            why = "another process, or another module of this one, uses it" if in_use else error.strerror
            raise StateDirError(f"state_dir {self.folder} cannot be used: {why}") from None

    def __exit__(self, *raised: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the folder for other processes."""
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def load(self) -> Mapping[ParameterGroup, bytes | OSError]:
        """The stored images by group; OSError for an unreadable one."""
        found: dict[ParameterGroup, bytes | OSError | None] = {}
        for group in ParameterGroup:
            try:
                found[group] = self._read(_file_name(group))
            except OSError as error:
                found[group] = error
        try:
            found |= self._pending()
        except OSError as error:
            found |= dict.fromkeys(PARAMETERS, error)
        return {group: image for group, image in found.items() if image is not None}

    def save(self, changes: Changes) -> None:
        """Store all of ``changes`` (None: delete), or with an OSError none."""
        if self._lock < 0:
            raise OSError(errno.EROFS, f"{self.folder} is closed, or open for reading only")
        with contextlib.suppress(FileNotFoundError):  # deleted with its folder: no other process has a lock
            if not os.path.samestat(os.fstat(self._lock), os.stat(self.folder / LOCK)):
                raise OSError(errno.EBUSY, "another process has taken it")
        try:
            self._finish(self._pending())
        except OSError as error:
            if error.errno != errno.EBADMSG:
                raise
            # The pending change is lost, and some files may be older: make all of them invalid.
            changes = dict.fromkeys(PARAMETERS, b"") | dict(changes)
        if not changes:
            return
        self._write(PENDING, _pack(changes))
        try:
            _sync_folder(self.folder)
        except OSError:
            self._remove(PENDING)
            raise
        with contextlib.suppress(OSError):  # the pending file is valid; the next save tries again
            self._finish(changes)

    def _pending(self) -> Changes:
        data = self._read(PENDING)
        return {} if data is None else _unpack(data)

    def _finish(self, changes: Changes) -> None:
        for group, image in changes.items():
            if image is None:
                self._remove(_file_name(group))
            else:
                self._write(_file_name(group), image)
        if changes:
            _sync_folder(self.folder)
            self._remove(PENDING)
            _sync_folder(self.folder)

    def _read(self, name: str) -> bytes | None:
        try:
            handle = os.open(self.folder / name, os.O_RDONLY)
        except FileNotFoundError:
            return None
        data = b""
        try:
            while part := os.read(handle, 1 << 16):
                data += part
                if len(data) > LARGEST_FILE:
                    raise OSError(errno.EFBIG, "it is far too large")
        finally:
            os.close(handle)
        return data

    def _write(self, name: str, data: bytes) -> None:
        """Replace the whole file, or leave it unchanged."""
        path, new = self.folder / name, self.folder / f"{name}.new"
        handle = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
        try:
            rest = memoryview(data)
            while rest:
                rest = rest[os.write(handle, rest) :]
            os.fsync(handle)
        finally:
            os.close(handle)
        os.replace(new, path)

    def _remove(self, name: str) -> None:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self.folder / name)


def _file_name(group: ParameterGroup) -> str:
    return f"{group.name.lower()}.bin"


def _pack(changes: Changes) -> bytes:
    parts = [_HEADER.pack(_MAGIC, len(changes))]
    for group, image in changes.items():
        content = b"" if image is None else image
        parts += [_PART.pack(group, image is not None, len(content)), content]
    body = b"".join(parts)
    return body + _CRC.pack(zlib.crc32(body))


def _unpack(data: bytes) -> Changes:
    body = data[: -_CRC.size]
    good = data.startswith(_MAGIC) and len(data) >= _HEADER.size + _CRC.size
    if not good or zlib.crc32(body) != _CRC.unpack_from(data, len(body))[0]:
        raise OSError(errno.EBADMSG, f"{PENDING} is damaged")
    changes: dict[ParameterGroup, bytes | None] = {}
    offset = _HEADER.size
    try:
        for _ in range(_HEADER.unpack_from(body)[1]):
            group, kept, size = _PART.unpack_from(body, offset)
            offset += _PART.size
            changes[ParameterGroup(group)] = body[offset : offset + size] if kept else None
            offset += size
    except (struct.error, ValueError):
        raise OSError(errno.EBADMSG, f"{PENDING} was written by another version of canfb") from None
    return changes


def _sync_folder(folder: Path) -> None:
    if sys.platform == "win32":
        return
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


# Switch interval of the interpreter, instead of 5 ms: how long the storing thread may delay the one that
# serves the bus. System calls of some microseconds release the interpreter too briefly for the other to run.
SWITCH_S = 2e-4
STACK_BYTES = 1 << 18  # instead of 8 MB, all of which lock_memory would occupy


@contextlib.contextmanager
def small_stack() -> Iterator[None]:
    """Threads started in this context get STACK_BYTES."""
    before = threading.stack_size(STACK_BYTES)
    try:
        yield
    finally:
        threading.stack_size(before)


class ThreadedStore:
    """Writes to ``store`` in one thread; :meth:`close` waits for it."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._begun: deque[Future[None]] = deque()
        self._executor = ThreadPoolExecutor(1, "canfb-save")
        self._switch_s = sys.getswitchinterval()
        sys.setswitchinterval(min(SWITCH_S, self._switch_s))
        with small_stack():
            self._executor.submit(int).result()

    def close(self) -> None:
        self._executor.shutdown()
        sys.setswitchinterval(self._switch_s)

    def load(self) -> Mapping[ParameterGroup, bytes | OSError]:
        return self._executor.submit(self._store.load).result()

    def save(self, changes: Changes) -> None:
        """Store and wait; OSError if that fails."""
        self._executor.submit(self._store.save, changes).result()

    def begin(self, changes: Changes) -> None:
        self._begun.append(self._executor.submit(self._store.save, changes))

    def ended(self) -> list[OSError | None]:
        ended: list[OSError | None] = []
        while self._begun and self._begun[0].done():
            try:
                ended.append(self._begun.popleft().result())
            except OSError as error:
                ended.append(error)
        return ended


class SavedParameters(StateFiles):
    """Read-only: no lock, no folder is created."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self._lock = -1

    def load(self) -> Mapping[ParameterGroup, bytes | OSError]:
        """Read until two readings agree: a save may be in progress."""
        before = super().load()
        for _ in range(_MOST_READINGS):
            again = super().load()
            if str(again) == str(before):  # as objects two errors are never equal
                break
            before = again
        return before
