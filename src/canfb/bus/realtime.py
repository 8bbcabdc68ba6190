"""Real-time options of the process (Linux): scheduling, memory lock, processor."""

from __future__ import annotations

import ctypes
import logging
import os
import threading
from collections.abc import Callable

from canfb.configuration import RealtimeConfig

log = logging.getLogger(__name__)

MCL_CURRENT, MCL_FUTURE = 1, 2


class RealtimeThread(threading.Thread):
    """A thread that the SYNC cycle waits for: priority and processor are its own, too."""


def apply_realtime(config: RealtimeConfig, report: Callable[[str], None] = log.warning) -> None:
    """Request what ``config`` sets; a refusal of the system is reported, and the program continues."""
    if config.priority:
        _try("priority", report, lambda: _set_fifo(config.priority))
    if config.lock_memory:
        _try("lock_memory", report, _lock_memory)
    if config.cpu is not None:
        cpu = config.cpu
        _try("cpu", report, lambda: _set_cpu(cpu))


def _try(name: str, report: Callable[[str], None], action: Callable[[], None]) -> None:
    try:
        action()
    except (OSError, AttributeError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        report(f"realtime: {name} could not be set: {reason}")


def _set_fifo(priority: int) -> None:
    # Not for processes that we start: a computation must not take the time of the SYNC cycle.
    for thread in _threads():
        os.sched_setscheduler(thread, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))


def _set_cpu(cpu: int) -> None:
    for thread in _threads():
        os.sched_setaffinity(thread, {cpu})


def _threads() -> list[int]:
    """The calling thread, and those that share its cycle; the system knows threads like processes."""
    others = [thread.native_id for thread in threading.enumerate() if isinstance(thread, RealtimeThread)]
    return [0, *(number for number in others if number is not None)]


def _lock_memory() -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(MCL_CURRENT | MCL_FUTURE) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
