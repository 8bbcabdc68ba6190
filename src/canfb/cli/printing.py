"""Output of a command: lines on stdout and stderr, also of what the program logs while a command runs."""

from __future__ import annotations

import contextlib
import errno
import json
import logging
import os
import sys
from collections.abc import Callable, Iterator
from typing import TextIO

from canfb.bus.clocks import now_s
from canfb.bus.line_output import LineOutput


def report(text: str) -> None:
    print_line(f"canfb: {text}", sys.stderr)


def say(text: str) -> None:
    print_line(text, sys.stdout)


def print_line(text: str, stream: TextIO) -> None:
    """Print at once, and in one piece: another thread may print beside it."""
    with reader_may_go(stream):
        stream.write(f"{text}\n")
        stream.flush()


@contextlib.contextmanager
def reader_may_go(stream: TextIO) -> Iterator[None]:
    """Without its reader or terminal the program goes on, and prints no more."""
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.EPIPE, errno.EIO):
            raise
        drop_output(stream)


def drop_output(stream: TextIO) -> None:
    """What is written from now on goes nowhere."""
    with contextlib.suppress(OSError, ValueError), open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), stream.fileno())


PATIENCE_S = 0.5  # at the end, for a reader


@contextlib.contextmanager
def printed_log() -> Iterator[None]:
    """Print what the loggers ``canfb.*`` say: information on stdout, warnings on stderr."""
    logger = logging.getLogger("canfb")
    before = logger.level, logger.propagate
    PRINTING.as_json = False
    logger.addHandler(PRINTING)
    logger.setLevel(logging.INFO)
    logger.propagate = False  # the root logger has a handler of its own, for python-can
    try:
        yield
    finally:
        logger.removeHandler(PRINTING)
        logger.level, logger.propagate = before


@contextlib.contextmanager
def printed_without_waiting() -> Iterator[None]:
    """Within :func:`printed_log`: the program does not wait for a reader that takes no lines."""
    PRINTING.outputs = {stream: output for stream in (sys.stdout, sys.stderr) if (output := _output(stream))}
    try:
        yield
    finally:
        PRINTING.flush(PATIENCE_S)
        PRINTING.outputs = {}


class _Printing(logging.Handler):
    """One line for each record; an output that fails is an error of the command.

    ``as_json``: from here to the end of the command, as JSON objects.
    """

    as_json = False

    def __init__(self) -> None:
        super().__init__()
        self.outputs: dict[TextIO, LineOutput] = {}

    def emit(self, record: logging.LogRecord) -> None:
        if self.as_json:
            message = {"event": "message", "level": record.levelname.lower(), "text": record.getMessage()}
            self._print(json.dumps(getattr(record, "event", message), ensure_ascii=False), sys.stdout)
        elif record.levelno >= logging.WARNING:
            self._print(f"canfb: {record.getMessage()}", sys.stderr)
        else:
            self._print(record.getMessage(), sys.stdout)

    def flush(self, wait_s: float = 0.0) -> None:
        for stream, output in self.outputs.items():
            with reader_may_go(stream):
                output.flush(wait_s)

    def left_out(self, lines: int) -> str:
        text = f"{lines} lines are missing here: they were not read in time"
        return json.dumps({"event": "message", "level": "warning", "text": text}) if self.as_json else text

    def _print(self, text: str, stream: TextIO) -> None:
        output = self.outputs.get(stream)
        if output is None:
            print_line(text, stream)
            return
        with reader_may_go(stream):
            output.put(text)


PRINTING = _Printing()  # of this process


def _output(stream: TextIO) -> LineOutput | None:
    """None on Windows, and for what is no file."""
    if sys.platform != "win32":
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
            return LineOutput(stream.fileno(), PRINTING.left_out, stream.encoding)
    return None


WIDTH = 30
CLEAR = "\r\x1b[K"
SOONEST_S = 2.0  # A rest is estimated from what has taken at least so long.
LINE_EVERY_S = 5.0  # Without a terminal a step that takes longer says so often how far it is.


@contextlib.contextmanager
def shown_progress(*, quiet: bool, interrupted: str = "") -> Iterator[Progress]:
    """Progress, taken away at the end; ``interrupted`` says what became of the work."""
    progress = Progress(quiet)
    try:
        yield progress
    except KeyboardInterrupt:
        progress.clear()
        if interrupted:
            report(f"interrupted; {interrupted}")
        raise
    finally:
        progress.clear()


class Progress:
    """One line a step; on a terminal a bar, else a line now and then. It never fails."""

    def __init__(
        self, quiet: bool = False, stream: TextIO | None = None, now: Callable[[], float] = now_s
    ) -> None:
        self._stream = stream or sys.stderr
        self._quiet = quiet
        self._bar = self._stream.isatty()
        self._now = now
        self._began_s = self._said_s = now()
        self._shown = ""

    def step(self, text: str) -> None:
        self.clear()
        self._began_s = self._said_s = self._now()
        self._print(f"... {text}\n")

    def part(self, part: float) -> None:
        part = min(max(part, 0.0), 1.0)
        percent = int(100.0 * part)
        if not self._bar:
            if part < 1.0 and self._now() - self._said_s >= LINE_EVERY_S:
                self._said_s = self._now()
                self._print(f"    {percent} %{self._rest(part)}\n")
            return
        full = round(WIDTH * percent / 100)
        text = f"    [{'#' * full}{'.' * (WIDTH - full)}] {percent:3d} %{self._rest(part)}"
        if text != self._shown:
            self._shown = text
            self._print(f"{CLEAR}{text}")

    def clear(self) -> None:
        if self._shown:
            self._shown = ""
            self._print(CLEAR)

    def _rest(self, part: float) -> str:
        """ "" while it is a guess."""
        passed_s = self._now() - self._began_s
        if passed_s < SOONEST_S or not 0.0 < part < 1.0:
            return ""
        minutes, seconds = divmod(round(passed_s * (1.0 - part) / part), 60)
        return f", {minutes} min {seconds:02d} s left" if minutes else f", {seconds} s left"

    def _print(self, text: str) -> None:
        if self._quiet:
            return
        try:
            print(text, end="", file=self._stream, flush=True)
        except OSError:
            self._quiet = True
