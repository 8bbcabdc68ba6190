"""Commands as processes of their own: what they say, how they end, and that nothing of them is left."""

import contextlib
import os
import re
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import pytest


def executed(arguments: tuple[str, ...]) -> subprocess.Popen[bytes]:
    """A process of its own, in a session of its own."""
    return subprocess.Popen(
        arguments,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
        start_new_session=True,
    )


def python(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    """A Python process to its end, and what it has said."""
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "stdin": subprocess.DEVNULL}
    words = {"text": True, "timeout": 300.0, "check": False, **streams, **options}
    return subprocess.run([sys.executable, *arguments], **words)


class Process:
    """A running command and what it has said, on standard output and standard error together.

    A wait ends in a failure, which shows what was said, when nothing is said for ``patience_s`` seconds.
    While the command goes on saying something, it may take as long as it takes.
    """

    def __init__(
        self,
        arguments: tuple[str, ...],
        patience_s: float = 60.0,
        start: Callable[[tuple[str, ...]], Any] = executed,
    ) -> None:
        self.arguments = arguments
        self.patience_s = patience_s
        self.lines: list[str] = []
        self._rest = b""
        self._unread = 0
        self._child = start(arguments)

    @property
    def pid(self) -> int:
        return self._child.pid

    def has_ended(self) -> bool:
        return self._child.poll() is not None

    def find(self, pattern: str, patience_s: float) -> str | None:
        """The next line in which the pattern is found, or None; lines before it are passed over."""
        while True:
            while self._unread < len(self.lines):
                line = self.lines[self._unread]
                self._unread += 1
                if re.search(pattern, line):
                    return line
            if not self._read(patience_s):
                return None

    def wait_for(self, pattern: str) -> str:
        """The next line in which the pattern is found."""
        line = self.find(pattern, self.patience_s)
        if line is None:
            pytest.fail(f"no line with {pattern!r}, and nothing new any more\n{self}", pytrace=False)
        return line

    def wait(self) -> int:
        """Exit status, when it ends by itself."""
        while self._read(self.patience_s):
            pass
        try:
            status = self._child.wait(self.patience_s)
        except subprocess.TimeoutExpired:
            pytest.fail(f"still running, silent for {self.patience_s:g} s\n{self}", pytrace=False)
        while self._read(0.0):  # it was silent for so long, and then said all at its end
            pass
        return status

    def send(self, number: signal.Signals) -> None:
        self._child.send_signal(number)

    def stop(self) -> int:
        """End it with SIGTERM; its exit status. Nothing that it started may be left."""
        if self._pipe.closed:
            return self._child.returncode
        try:
            if self._child.poll() is None:
                self._child.send_signal(signal.SIGTERM)
            status = self.wait()
            if self._group_is_alive():
                pytest.fail(f"it has ended, a process that it started has not\n{self}", pytrace=False)
            return status
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._child.pid, signal.SIGKILL)
            self._child.wait()
            self._pipe.close()

    def __str__(self) -> str:
        said = "".join(f"    {line}\n" for line in self.lines)
        return f"{' '.join(self.arguments)} said:\n{said or '    nothing'}"

    @property
    def _pipe(self) -> Any:
        return self._child.stdout

    def _read(self, patience_s: float) -> bool:
        """Take what there is to read; False at the end of the output, or when nothing comes for so long."""
        ready, _, _ = select.select([self._pipe], [], [], patience_s)
        chunk = os.read(self._pipe.fileno(), 1 << 16) if ready else b""
        *whole, self._rest = (self._rest + chunk).split(b"\n")
        self.lines += [line.decode(errors="replace") for line in whole]
        if not chunk and self._rest:  # the last line may have no end
            self.lines.append(self._rest.decode(errors="replace"))
            self._rest = b""
        return bool(chunk)

    def _group_is_alive(self) -> bool:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._child.pid, 0)
            return True
        return False


Started = Callable[..., Process]


@contextlib.contextmanager
def commands(patience_s: float, start: Callable[[tuple[str, ...]], Any] = executed) -> Iterator[Started]:
    """Starts any command; all are ended afterwards, and what they said is shown where a test fails."""
    with contextlib.ExitStack() as stack:

        def start_one(*arguments: str) -> Process:
            one = Process(arguments, patience_s, start)
            stack.callback(print, one)
            stack.callback(one.stop)
            return one

        yield start_one
