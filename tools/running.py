"""Programs beside a tool, until the end of a ``with``."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Iterator, Sequence
from typing import IO


def canfb(*arguments: str) -> list[str]:
    """The command line of canfb, whose output comes at once."""
    return [sys.executable, "-u", "-m", "canfb", *arguments]


@contextlib.contextmanager
def running(
    command: Sequence[str], output: IO[bytes] | int = subprocess.DEVNULL
) -> Iterator[subprocess.Popen[bytes]]:
    """The process; what it says, errors too, goes to ``output``. It is killed at the end, stopped or not."""
    program = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT)
    try:
        yield program
    finally:
        program.kill()
        program.wait()
