"""What an input must not do: take much processor time or memory, write files, start programs.

Time is that of the processor: no limit depends on what else the computer does.
"""

from __future__ import annotations

import os
import resource
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

LONGEST_S = 10.0
"""Of the processor for one input, of at most 64 kB, while it is traced: three hundred times the usual."""
MOST_MEMORY = 128 << 20
"""Bytes by which the largest memory of the process may grow with one input: two thousand times the input."""
WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
ACTIONS = frozenset(
    f"{group}.{name}"
    for group, names in {
        "os": "remove rename rmdir mkdir link symlink truncate chmod chown system exec posix_spawn fork kill",
        "subprocess": "Popen",
        "shutil": "rmtree move copyfile",
        "socket": "connect bind sendto",
        "pickle": "find_class",
        "ctypes": "dlopen",
    }.items()
    for name in names.split()
)
"""Events of audit hooks that no input may cause outside of the folder."""
MOVES = frozenset({"os.rename", "os.link"})
"""Those of two paths."""


class BeyondBoundsError(BaseException):
    """An input did what none may do. No ``except Exception`` hides it."""


class _WatchedFolder:
    """The only folder that may be written to; None while nothing is watched. Audit hooks stay for good."""

    path: str | None = None
    hooked = False

    @classmethod
    def hook(cls, event: str, arguments: tuple[Any, ...]) -> None:
        if cls.path is None:
            return
        writes = event == "open" and isinstance(arguments[2], int) and arguments[2] & WRITES
        if not writes and event not in ACTIONS:
            return
        if not all(cls._holds(name) for name in arguments[: 2 if event in MOVES else 1]):
            raise BeyondBoundsError(f"{event}{arguments!r:.200}")

    @classmethod
    def _holds(cls, name: object) -> bool:
        """Whether this is a path in the folder, or an open file."""
        if isinstance(name, (str, bytes)) and cls.path is not None:
            return os.path.abspath(os.fsdecode(name)).startswith(cls.path)
        return isinstance(name, int)


@contextmanager
def bounded(folder: Path, seconds: float = LONGEST_S, memory: int = MOST_MEMORY) -> Iterator[None]:
    """BeyondBoundsError for what takes more, and for what is written outside of ``folder`` or started."""
    if not _WatchedFolder.hooked:
        sys.addaudithook(_WatchedFolder.hook)
        _WatchedFolder.hooked = True
    before, cached = signal.signal(signal.SIGVTALRM, _too_long), sys.dont_write_bytecode
    largest = _largest_memory()
    sys.dont_write_bytecode = True
    _WatchedFolder.path = str(folder.resolve())
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        _WatchedFolder.path = None
        sys.dont_write_bytecode = cached
        signal.signal(signal.SIGVTALRM, before)
    grown = _largest_memory() - largest
    if grown > memory:
        raise BeyondBoundsError(f"the memory grows by {grown >> 20} MB")


def _too_long(number: int, frame: FrameType | None) -> None:
    raise BeyondBoundsError("it takes too long")


def _largest_memory() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
