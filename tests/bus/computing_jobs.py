"""Jobs for another process; it imports them by this name."""

import os
import sys
import time
from collections.abc import Callable

Tell = Callable[[float], None]


def add(numbers: tuple[int, ...], tell: Tell) -> int:
    """Adds numbers up, and says on the way how far it is."""
    tell(0.25)
    print("what a job prints is no answer")
    tell(1.0)
    return sum(numbers)


def tell_of_the_process(tell: Tell) -> tuple[int, int, str, set[int], str]:
    niceness, threads = os.getpriority(os.PRIO_PROCESS, 0), os.environ["OPENBLAS_NUM_THREADS"]
    return os.getpid(), niceness, sys.argv[0], os.sched_getaffinity(0), threads


def fail(tell: Tell) -> None:
    raise LookupError("nothing to be found")


def crash(tell: Tell) -> None:
    """Ends its process without a word."""
    os._exit(3)


def never_end(tell: Tell) -> None:
    tell(float(os.getpid()))
    while True:
        time.sleep(60.0)
