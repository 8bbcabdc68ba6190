"""Limits of an input: processor time, memory; it must not write files or start programs.

Time is processor time, which does not depend on other work of the computer.
"""

import os
import resource
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
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
    """An input exceeded a limit. Not an Exception, so that ``except Exception`` does not hide it."""


_folder: str | None = None
"""The only one that may be written to; None while nothing is watched."""


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    if _folder is None:
        return
    writes = event == "open" and isinstance(arguments[2], int) and arguments[2] & WRITES
    if (writes or event in ACTIONS) and not all(map(_is_ours, arguments[: 2 if event in MOVES else 1])):
        raise BeyondBoundsError(f"{event}{arguments!r:.200}")


def _is_ours(name: object) -> bool:
    """Whether ``name`` is a path in the folder, or the descriptor of an open file."""
    if isinstance(name, (str, bytes)) and _folder is not None:
        return os.path.abspath(os.fsdecode(name)).startswith(_folder)
    return isinstance(name, int)


@cache
def _hook_for_good() -> None:
    sys.addaudithook(_hook)


@contextmanager
def bounded(folder: Path, seconds: float = LONGEST_S, memory: int = MOST_MEMORY) -> Iterator[None]:
    """BeyondBoundsError for more time or memory, writing outside of ``folder``, or starting a program."""
    global _folder
    _hook_for_good()
    before, cached = signal.signal(signal.SIGVTALRM, _too_long), sys.dont_write_bytecode
    largest = _largest_memory()
    sys.dont_write_bytecode = True
    _folder = str(folder.resolve())
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        _folder = None
        sys.dont_write_bytecode = cached
        signal.signal(signal.SIGVTALRM, before)
    grown = _largest_memory() - largest
    if grown > memory:
        raise BeyondBoundsError(f"the memory grows by {grown >> 20} MB")


def _too_long(number: int, frame: FrameType | None) -> None:
    raise BeyondBoundsError("it takes too long")


def _largest_memory() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
