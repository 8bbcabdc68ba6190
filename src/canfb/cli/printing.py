"""Output of a command: lines on stdout and stderr."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from collections.abc import Iterator
from typing import TextIO


def report(text: str) -> None:
    """One line on stderr."""
    print_line(f"canfb: {text}", sys.stderr)


def say(text: str) -> None:
    """One line on stdout, of a program that goes on after it."""
    print_line(text, sys.stdout)


def print_line(text: str, stream: TextIO) -> None:
    """Print at once, and in one piece: another thread may print beside it."""
    with reader_may_go(stream):
        stream.write(f"{text}\n")
        stream.flush()


@contextlib.contextmanager
def reader_may_go(stream: TextIO) -> Iterator[None]:
    """A reader or a terminal that has gone does not end the program: no more output there."""
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.EPIPE, errno.EIO):
            raise
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def announce_page(address: str, code: str | None) -> None:
    """Say the address of the page, and the code of the tasks that write."""
    say(f"open {address}")
    if code is not None:
        say(f"to change a module, type this code on the page: {code}")
