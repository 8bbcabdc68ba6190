"""A terminal that goes while a new table is being proven: the old one comes back, as with Ctrl-C."""

from __future__ import annotations

import io
import os
import pty
import signal
from typing import TextIO

import pytest
from test_calibrate_on_a_bus import SHORT

from canfb.bus.runner import ending_on_signals
from canfb.cli.calibrate import over_bus
from canfb.cli.main import build_parser
from canfb.cli.progress import Progress
from canfb.configuration import Config
from canfb.master.all_or_nothing import Guard, read_active
from canfb.signal.correction import NO_CORRECTION
from commissioning_kit import Bench


def interrupted(bench: Bench, times: int, stream: TextIO, gone: int | None = None) -> None:
    """`canfb calibrate`, and SIGHUP as soon as the new table is active; ``gone``: and the terminal."""
    options = build_parser().parse_args(["calibrate", *SHORT])
    guard, terminal = Guard(), [] if gone is None else [gone]

    def hang_up(now: float) -> None:
        if bench.value(0x2020, 4):
            for descriptor in terminal:
                os.close(descriptor)
            terminal.clear()
            for _ in range(times):
                signal.raise_signal(signal.SIGHUP)

    bench.master.on_wait = hang_up
    with ending_on_signals(guard.interrupt):
        over_bus(bench.master, options, Config(), Progress(stream=stream), guard, "2026-03-01")


def test_a_hangup_while_it_is_proven_puts_the_old_table_back() -> None:
    bench, said = Bench(), io.StringIO()
    with pytest.raises(KeyboardInterrupt):
        interrupted(bench, 1, said)
    bench.master.on_wait = lambda now: None
    assert read_active(bench.access) == NO_CORRECTION
    assert said.getvalue().splitlines()[-2:] == [
        "... restoring the old table",
        "... the previous table and conditioning are active in module 32 (20h)",
    ]


def test_a_terminal_that_has_gone_does_not_keep_the_old_table_away() -> None:
    bench = Bench()
    ours, theirs = pty.openpty()
    stream = os.fdopen(theirs, "w", encoding="utf-8")
    with pytest.raises(KeyboardInterrupt):
        interrupted(bench, 2, stream, gone=ours)
    with pytest.raises(OSError, match="Input/output error"):
        stream.close()  # what it still holds
    bench.master.on_wait = lambda now: None
    assert read_active(bench.access) == NO_CORRECTION


def test_the_second_signal_is_too_late_to_stop_what_the_first_one_began() -> None:
    guard = Guard()
    with pytest.raises(KeyboardInterrupt):
        guard.interrupt()
    guard.interrupt()
    with guard.held():
        guard.interrupt()
    guard.interrupt()


class Gone(io.StringIO):
    """A terminal that refuses all."""

    def isatty(self) -> bool:
        return True

    def write(self, text: str) -> int:
        raise OSError(5, "Input/output error")


def test_progress_never_fails() -> None:
    progress = Progress(stream=Gone())
    progress.step("one")
    progress.part(0.5)
    progress.clear()
