"""Kill a process at one of its system calls: Linux, with ptrace."""

from __future__ import annotations

import ctypes
import os
import signal
from collections.abc import Callable

TRACEME, SYSCALL, SETOPTIONS = 0, 24, 0x4200
TRACESYSGOOD, EXITKILL = 1, 0x100000
SYSCALL_STOP = signal.SIGTRAP | 0x80
REFUSED = 77  # exit status of a child that may not be traced

_libc = ctypes.CDLL(None, use_errno=True)
_libc.ptrace.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
_libc.ptrace.restype = ctypes.c_long


class NotTraced(Exception):
    """This system lets no process be traced."""


def killed_at(work: Callable[[], None], place: int) -> bool:
    """Run `work()` in a child and kill that at its stop number `place`, from 1; False if it ended before.

    A stop is the entry into a system call, which is then not executed, or the return from it.
    """
    child = os.fork()
    if child == 0:
        _work_traced(work)
    _, status = os.waitpid(child, 0)
    if not os.WIFSTOPPED(status):
        raise NotTraced
    _ptrace(SETOPTIONS, child, TRACESYSGOOD | EXITKILL)
    stops = 0
    while stops < place:
        _ptrace(SYSCALL, child)
        _, status = os.waitpid(child, 0)
        if not os.WIFSTOPPED(status):
            if status != 0:
                raise RuntimeError(f"the work failed, wait status {status:#x}")
            return False
        stops += os.WSTOPSIG(status) == SYSCALL_STOP
    os.kill(child, signal.SIGKILL)
    while not (os.WIFSIGNALED(status) or os.WIFEXITED(status)):
        _, status = os.waitpid(child, 0)
    return os.WIFSIGNALED(status)


def _work_traced(work: Callable[[], None]) -> None:
    """In the child; it ends here."""
    try:
        if _libc.ptrace(TRACEME, 0, None, None) != 0:
            os._exit(REFUSED)
        os.kill(os.getpid(), signal.SIGSTOP)
        work()
    except BaseException:
        os._exit(1)
    os._exit(0)


def _ptrace(request: int, process: int, data: int = 0) -> None:
    if _libc.ptrace(request, process, None, data) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
