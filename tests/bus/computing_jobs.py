"""Jobs for another process; it imports them by this name."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

Tell = Callable[[float], None]


@dataclass(frozen=True)
class Sum:
    """Adds numbers up, and says on the way how far it is."""

    numbers: tuple[int, ...]

    def __call__(self, progress: Tell = lambda part: None) -> int:
        progress(0.25)
        print("what a job prints is no answer")
        progress(1.0)
        return sum(self.numbers)


@dataclass(frozen=True)
class Where:
    """Tells of the process that it runs in."""

    def __call__(self, progress: Tell = lambda part: None) -> tuple[int, int, str, set[int]]:
        return os.getpid(), os.getpriority(os.PRIO_PROCESS, 0), sys.argv[0], os.sched_getaffinity(0)


@dataclass(frozen=True)
class Raise:
    """Fails as a program does."""

    def __call__(self, progress: Tell = lambda part: None) -> None:
        raise LookupError("nothing to be found")


@dataclass(frozen=True)
class Crash:
    """Ends its process without a word."""

    status: int

    def __call__(self, progress: Tell = lambda part: None) -> None:
        os._exit(self.status)


@dataclass(frozen=True)
class Forever:
    """Never comes to an end; tells its process first."""

    def __call__(self, progress: Tell = lambda part: None) -> None:
        progress(float(os.getpid()))
        while True:
            time.sleep(60.0)
