"""A disk that fails at a chosen call: what is not synchronised may be lost, as on a real one."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any


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
    def __init__(self) -> None:
        self.data = b""
        self.synchronised = b""


class FakeDisk:
    """One folder in memory. A power failure leaves what `after` makes of it."""

    def __init__(self, folder: Path) -> None:
        self.folder = str(folder)
        self.names: dict[str, File] = {}
        self.lasting: dict[str, File] = {}
        self.trouble = Trouble()
        self._open: dict[int, tuple[File | None, int]] = {}
        self._next_handle = 100

    def __getattr__(self, name: str) -> Any:
        assert name.startswith("O_"), f"the fake disk has no {name}"
        return getattr(os, name)

    def open(self, path: Path, flags: int, mode: int = 0) -> int:
        self.trouble.step()
        name = str(path)
        file = None
        if name != self.folder:
            if name not in self.names and not flags & os.O_CREAT:
                raise FileNotFoundError(name)
            file = self.names.setdefault(name, File())
            if flags & os.O_TRUNC:
                file.data = b""
        self._next_handle += 1
        self._open[self._next_handle] = (file, 0)
        return self._next_handle

    def read(self, handle: int, size: int) -> bytes:
        self.trouble.step()
        file, place = self._open[handle]
        assert file is not None
        part = file.data[place : place + min(size, 50)]
        self._open[handle] = (file, place + len(part))
        return part

    def write(self, handle: int, data: bytes) -> int:
        self.trouble.step()
        file, _ = self._open[handle]
        assert file is not None
        part = bytes(data[:50])
        file.data += part
        return len(part)

    def fsync(self, handle: int) -> None:
        self.trouble.step()
        file, _ = self._open[handle]
        if file is None:
            self.lasting = dict(self.names)
        else:
            file.synchronised = file.data

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
        disk = FakeDisk(Path(self.folder))
        for name, file in (self.names if names_kept else self.lasting).items():
            copy = File()
            copy.data = copy.synchronised = file.data if data_kept else file.synchronised
            disk.names[name] = disk.lasting[name] = copy
        return disk
