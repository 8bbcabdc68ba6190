"""The processes of the tests: lines, status, signals, and nothing left behind."""

from __future__ import annotations

import contextlib
import signal
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
