"""The processes of the tests: lines, status, signals, and nothing left behind."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Callable, Iterator

import pytest

from processes import Process


@pytest.fixture
def command() -> Iterator[Callable[..., Process]]:
    """Starts a command; all are ended after the test."""
    with contextlib.ExitStack() as stack:

        def start(*arguments: str) -> Process:
            one = Process(arguments)
            stack.callback(one.stop)
            return one

        yield start


def test_a_command_that_ends_by_itself_gives_lines_and_status(command: Callable[..., Process]) -> None:
    script = "import sys; print('one'); print('two', file=sys.stderr); sys.stdout.write('three'); sys.exit(3)"
    started = command(sys.executable, "-c", script)
    assert started.wait_for("^t") == "two"
    assert started.wait() == 3
    assert started.lines == ["one", "two", "three"]


def test_a_command_that_runs_on_is_ended_with_sigterm(command: Callable[..., Process]) -> None:
    script = (
        "import signal, sys\n"
        "signal.signal(signal.SIGTERM, lambda *_: sys.exit('bye'))\n"
        "print('ready')\n"
        "signal.pause()\n"
    )
    started = command(sys.executable, "-c", script)
    started.wait_for("ready")
    assert started.stop() == 1
    assert started.lines == ["ready", "bye"]


def test_a_process_left_behind_is_found(command: Callable[..., Process]) -> None:
    started = command("sh", "-c", "sleep 1000 >/dev/null 2>&1 & echo ready")
    started.wait_for("ready")
    with pytest.raises(pytest.fail.Exception, match="has ended, a process that it started has not"):
        started.stop()


def test_a_line_that_does_not_come_fails_and_shows_what_was_said(command: Callable[..., Process]) -> None:
    started = command("sh", "-c", "echo something; exec sleep 1000")
    started.wait_for("something")
    started.patience_s = 0.0
    with pytest.raises(pytest.fail.Exception, match="something"):
        started.wait_for("else")
    started.patience_s = 60.0
    started.send(signal.SIGKILL)
    assert started.wait() == -signal.SIGKILL
