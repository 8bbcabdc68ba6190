"""Tests on a real SocketCAN interface: what they need, and what they may use.

Run them with `make socketcan`, or `python tools/vcan.py run -- .venv/bin/python -m pytest tests/socketcan`.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest

CHANNEL = "vcan0"
NO_VCAN = f"no SocketCAN interface {CHANNEL}; run: python tools/vcan.py run -- pytest tests/socketcan"
HERE = Path(__file__).parent


def vcan_is_up() -> bool:
    flags = Path(f"/sys/class/net/{CHANNEL}/flags")
    return flags.exists() and bool(int(flags.read_text(), 16) & 1)


@pytest.hookimpl(tryfirst=True)  # before -m chooses
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if HERE in item.path.parents:
            item.add_marker(pytest.mark.socketcan)


def pytest_runtest_setup() -> None:
    if not vcan_is_up():
        skip_unless_required(NO_VCAN)


def skip_unless_required(reason: str) -> None:
    """Skip the test; where CANFB_REQUIRE_VCAN=1 says that nothing may be missing, fail it."""
    if os.environ.get("CANFB_REQUIRE_VCAN") == "1":
        pytest.fail(reason, pytrace=False)
    pytest.skip(reason)


class Process:
    """A running command and what it has said, on standard output and standard error together.

    Every wait has a limit in seconds; reaching it fails the test and shows what was said until then.
    """

    def __init__(self, arguments: tuple[str, ...]) -> None:
        self.arguments = arguments
        self.lines: list[str] = []
        self._rest = b""
        self._unread = 0
        self._child = subprocess.Popen(
            arguments,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
            start_new_session=True,
        )

    @property
    def pid(self) -> int:
        """Process id, for signals."""
        return self._child.pid

    def find(self, pattern: str, within_s: float) -> str | None:
        """The next line in which the pattern is found, or None; lines before it are passed over."""
        deadline = time.monotonic() + within_s
        while True:
            while self._unread < len(self.lines):
                line = self.lines[self._unread]
                self._unread += 1
                if re.search(pattern, line):
                    return line
            if not self._read(deadline):
                return None

    def wait_for(self, pattern: str, within_s: float = 20.0) -> str:
        """The next line in which the pattern is found."""
        line = self.find(pattern, within_s)
        if line is None:
            pytest.fail(f"no line with {pattern!r} within {within_s:g} s\n{self}", pytrace=False)
        return line

    def wait(self, within_s: float = 20.0) -> int:
        """Exit status, when it ends by itself."""
        deadline = time.monotonic() + within_s
        while self._read(deadline):
            pass
        try:
            return self._child.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            pytest.fail(f"still running after {within_s:g} s\n{self}", pytrace=False)

    def send(self, number: signal.Signals) -> None:
        """Send it a signal."""
        self._child.send_signal(number)

    def stop(self, within_s: float = 20.0) -> int:
        """End it with SIGTERM; its exit status. Nothing that it started may be left."""
        if self._pipe.closed:
            return self._child.returncode
        try:
            if self._child.poll() is None:
                self._child.send_signal(signal.SIGTERM)
            status = self.wait(within_s)
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

    def _read(self, deadline: float) -> bool:
        """Take what there is to read; False at the end of the output or at the deadline."""
        ready, _, _ = select.select([self._pipe], [], [], max(0.0, deadline - time.monotonic()))
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


@pytest.fixture
def can_channel() -> str:
    """Name of the SocketCAN interface."""
    return CHANNEL


@pytest.fixture
def can_utils() -> None:
    """For tests that use candump, cansend and their like."""
    if shutil.which("candump") is None:
        skip_unless_required("no can-utils; run: apt-get install can-utils")


@pytest.fixture
def command() -> Iterator[Callable[..., Process]]:
    """Starts any command: command("candump", "-L", "vcan0"). All are ended after the test."""
    started: list[Process] = []

    def start(*arguments: str) -> Process:
        started.append(Process(arguments))
        return started[-1]

    with contextlib.ExitStack() as stack:
        yield start
        for one in started:
            stack.callback(one.stop)


@pytest.fixture
def process(command: Callable[..., Process]) -> Callable[..., Process]:
    """Starts a command of the project: process("run", "module.yaml"). All are ended after the test."""

    def start(*arguments: str) -> Process:
        return command(sys.executable, "-m", "canfb", *arguments)

    return start


@pytest.fixture
def open_bus(can_channel: str) -> Iterator[Callable[..., can.BusABC]]:
    """Opens python-can buses on the interface: open_bus(can_filters=...). All are closed after the test."""
    with contextlib.ExitStack() as stack:

        def open_one(**options: Any) -> can.BusABC:
            bus = can.Bus(interface="socketcan", channel=can_channel, **options)
            stack.callback(bus.shutdown)
            return bus

        yield open_one


@pytest.fixture
def can_bus(open_bus: Callable[..., can.BusABC]) -> can.BusABC:
    """One python-can bus on the interface."""
    return open_bus()
