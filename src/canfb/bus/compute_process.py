"""Reads one job from standard input, computes it, reports progress and result."""

import contextlib
import os
import pickle
import sys
from multiprocessing.connection import Connection

NICENESS = 10  # the process that serves the bus has priority


def main() -> None:
    with contextlib.suppress(OSError, AttributeError):
        os.nice(NICENESS)
    answers = Connection(os.dup(sys.stdout.fileno()), readable=False)
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    try:
        result = pickle.load(sys.stdin.buffer)(answers.send)
    except Exception as error:  # any failure must reach the module
        result = RuntimeError(f"{type(error).__name__}: {error}")
    with contextlib.suppress(BrokenPipeError):  # nobody reads the result any more
        answers.send(result)


if __name__ == "__main__":
    main()
