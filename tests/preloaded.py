"""Commands of the project without the cost of their start: forked from a process that has imported them.

A command imports several hundred modules. In a user-mode Linux, where a page fault takes some 40 µs, that is
1.5 s of processor time for each start, and the tests there start some sixty; a fork takes 0.15 s. What runs
in the fork is `python -m canfb`: a session, standard streams, an environment and an end of its own, as in a
process that was executed. What an exec is needed for is tested with one: the README's session, tests/cli.
"""

from __future__ import annotations

import atexit
import gc
import importlib
import io
import json
import os
import pkgutil
import runpy
import select
import signal
import socket
import subprocess
import sys
import threading
import traceback
from collections.abc import Sequence
from typing import IO, NoReturn, Self

LARGEST_ORDER = 1 << 17  # bytes: arguments and environment


class Preloaded:
    """The process that commands are forked from; it ends with this object, or with this process."""

    def __init__(self) -> None:
        self._orders, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, __file__, str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                env={**os.environ, "PYTHONUNBUFFERED": "1"},
                pass_fds=[theirs.fileno()],
                start_new_session=True,  # Ctrl-C is for those who ask for commands
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._orders.close()
        self._process.wait()

    def start(self, arguments: Sequence[str]) -> Forked:
        """`canfb ARGUMENTS`, with the environment and the working directory of this process."""
        read, write = os.pipe()
        with open(write, "wb") as output:
            order = {"arguments": arguments, "folder": os.getcwd(), "environment": dict(os.environ)}
            socket.send_fds(self._orders, [json.dumps(order).encode()], [output.fileno()])
        return Forked(self, json.loads(self._orders.recv(LARGEST_ORDER)), open(read, "rb", buffering=0))

    def status(self, pid: int) -> int | None:
        """The exit status of a command, or None while it runs."""
        self._orders.send(json.dumps({"pid": pid}).encode())
        status: int | None = json.loads(self._orders.recv(LARGEST_ORDER))
        return status


class Forked:
    """A command, with what a subprocess.Popen has."""

    def __init__(self, preloaded: Preloaded, pid: int, stdout: IO[bytes]) -> None:
        self.pid, self.stdout = pid, stdout
        self.returncode: int | None = None
        self._preloaded = preloaded

    def poll(self) -> int | None:
        """The exit status, or None while it runs."""
        if self.returncode is None:
            self.returncode = self._preloaded.status(self.pid)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """The exit status, at its end; subprocess.TimeoutExpired after so many seconds."""
        if self.poll() is None:
            end = os.pidfd_open(self.pid)
            try:
                select.select([end], [], [], timeout)
            finally:
                os.close(end)
        if self.poll() is None:
            raise subprocess.TimeoutExpired("canfb", timeout or 0.0)
        assert self.returncode is not None
        return self.returncode

    def send_signal(self, number: signal.Signals) -> None:
        """Send it a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)


def serve(orders: socket.socket) -> None:
    """Fork what is asked for, and say how it ended; returns in the fork, or never."""
    while True:
        message, (*outputs,), _, _ = socket.recv_fds(orders, LARGEST_ORDER, 1)
        if not message:
            os._exit(0)
        order = json.loads(message)
        if "pid" in order:
            ended, status = os.waitpid(order["pid"], os.WNOHANG)
            orders.send(json.dumps(os.waitstatus_to_exitcode(status) if ended else None).encode())
            continue
        pid = os.fork()
        if pid == 0:
            orders.close()
            become(order["arguments"], order["folder"], order["environment"], outputs[0])
            return
        os.close(outputs[0])
        orders.send(json.dumps(pid).encode())


def become(arguments: Sequence[str], folder: str, environment: dict[str, str], output: int) -> None:
    """What an exec would have made of this process."""
    os.setsid()
    for stream in (1, 2):
        os.dup2(output, stream)
    os.close(output)
    sys.stdout = new_stream(1, "strict")
    sys.stderr = new_stream(2, "backslashreplace")
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv[1:] = arguments


def run_command() -> int:
    """`python -m canfb`; its exit status."""
    try:
        runpy.run_module("canfb", run_name="__main__", alter_sys=True)
    except SystemExit as ending:
        if ending.code is None or isinstance(ending.code, int):
            return ending.code or 0
        print(ending.code, file=sys.stderr)
        return 1
    except BaseException:
        traceback.print_exc()
        return 1
    return 0


def end(status: int) -> NoReturn:
    """As the interpreter ends, except that it takes nothing to pieces: that would copy every page."""
    threading._shutdown()  # type: ignore[attr-defined]  # waits for threads, as the interpreter does
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status & 0xFF)


def new_stream(number: int, errors: str) -> io.TextIOWrapper:
    """As Python makes it with PYTHONUNBUFFERED; the one of the parent may be a file, which can seek."""
    return io.TextIOWrapper(open(number, "wb", buffering=0, closefd=False), errors=errors, write_through=True)


def import_all() -> None:
    """Every module of the project, and so what these import."""
    import canfb

    for module in pkgutil.walk_packages(canfb.__path__, "canfb."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    importlib.import_module("can.interfaces.socketcan")
    gc.freeze()  # a collection would write to all pages, and so copy them


if __name__ == "__main__":
    import_all()
    serve(socket.socket(fileno=int(sys.argv[1])))
    end(run_command())
