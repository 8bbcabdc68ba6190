"""Real-time options of the process (Linux)."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import logging
import os
import sys
import threading
from collections.abc import Callable, Iterator

from canfb.configuration import RealtimeConfig
from canfb.errors import reason

log = logging.getLogger(__name__)

MCL_CURRENT, MCL_FUTURE = 1, 2

_REFUSALS = frozenset({errno.EPERM, errno.ENOMEM})
_RIGHTS = {
    "priority": ("cap_sys_nice", "LimitRTPRIO=99"),
    "lock_memory": ("cap_ipc_lock", "LimitMEMLOCK=infinity"),
}


class RealtimeThread(threading.Thread):
    """A thread on which the SYNC cycle depends."""


def apply_realtime(config: RealtimeConfig, report: Callable[[str], None] = log.warning) -> None:
    """Request the options that ``config`` sets; a refusal is reported."""
    if config.priority:
        with _reporting("priority", report):
            # Child processes are reset: a computation must not take time from the SYNC cycle.
            for thread in _threads():
                os.sched_setscheduler(
                    thread, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(config.priority)
                )
    if config.lock_memory:
        with _reporting("lock_memory", report):
            _lock_memory()
    if config.cpu is not None:
        with _reporting("cpu", report):
            # With busy_poll the main thread occupies the CPU, so other threads must run elsewhere.
            for thread in [0] if config.busy_poll else _threads():
                os.sched_setaffinity(thread, {config.cpu})


@contextlib.contextmanager
def _reporting(name: str, report: Callable[[str], None]) -> Iterator[None]:
    try:
        yield
    except (OSError, AttributeError, ValueError) as error:
        report(f"realtime: {name} could not be set: {reason(error)}{_suggestion(name, error)}")


def _suggestion(name: str, error: Exception) -> str:
    if name not in _RIGHTS or not isinstance(error, OSError) or error.errno not in _REFUSALS:
        return ""
    capability, limit = _RIGHTS[name]
    python = os.path.realpath(sys.executable)
    return f"; sudo setcap {capability}+ep {python}, or {limit} in the systemd unit; see docs/service.md"


def _threads() -> list[int]:
    others = [thread.native_id for thread in threading.enumerate() if isinstance(thread, RealtimeThread)]
    return [0, *(number for number in others if number is not None)]


def _lock_memory() -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(MCL_CURRENT | MCL_FUTURE) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
