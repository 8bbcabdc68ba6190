"""The other process: takes one job, computes it, reports progress and result.

    python -m canfb.bus.compute_process

Standard input is a pickled job, standard output pickled messages on a pipe, each with its length before it.
Only the process that started it talks to it.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import sys
from collections.abc import Iterator
from typing import Any, BinaryIO

LENGTH_BYTES = 4


def pack(message: object) -> bytes:
    """One message."""
    data = pickle.dumps(message)
    return len(data).to_bytes(LENGTH_BYTES, "little") + data


class Inbox:
    """Puts together what comes in pieces."""

    def __init__(self) -> None:
        self._data = bytearray()

    def add(self, piece: bytes) -> None:
        """The next piece."""
        self._data += piece

    def messages(self) -> Iterator[Any]:
        """The messages that are complete, each once. What pickle raises if one is none."""
        while len(self._data) >= LENGTH_BYTES:
            end = LENGTH_BYTES + int.from_bytes(self._data[:LENGTH_BYTES], "little")
            if len(self._data) < end:
                return
            message = bytes(self._data[LENGTH_BYTES:end])
            del self._data[:end]
            yield pickle.loads(message)


NICENESS = 10  # frames come first


def compute(source: BinaryIO, answers: BinaryIO) -> None:
    """Do the job that ``source`` holds; what happens goes to ``answers``."""

    def report(message: object) -> None:
        answers.write(pack(message))
        answers.flush()

    try:
        result = pickle.load(source)(report)
    except Exception as error:  # whatever it is, the module must be notified
        result = RuntimeError(f"{type(error).__name__}: {error}")
    report(result)


def main() -> None:
    """Compute; what the job itself prints goes nowhere near the answers."""
    with contextlib.suppress(OSError, AttributeError):
        os.nice(NICENESS)
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    with contextlib.suppress(BrokenPipeError), answers:  # the result is no longer needed
        compute(sys.stdin.buffer, answers)


if __name__ == "__main__":
    main()
