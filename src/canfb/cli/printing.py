"""Output of a command: lines on stdout and stderr, including log messages of the program."""

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
    """Print at once, in one call: other threads may print."""
    with reader_may_go(stream):
        stream.write(f"{text}\n")
        stream.flush()


@contextlib.contextmanager
def reader_may_go(stream: TextIO) -> Iterator[None]:
    """If reader or terminal disappear, the program continues without output."""
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.EPIPE, errno.EIO):
            raise
        drop_output(stream)


def drop_output(stream: TextIO) -> None:
    """Discard all further output."""
    with contextlib.suppress(OSError, ValueError), open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), stream.fileno())


PATIENCE_S = 0.5  # time for a slow reader at the end


@contextlib.contextmanager
def printed_log() -> Iterator[None]:
    """Print messages of the loggers ``canfb.*``: information on stdout, warnings on stderr."""
    logger = logging.getLogger("canfb")
    before = logger.level, logger.propagate
    PRINTING.as_json = False
    logger.addHandler(PRINTING)
    logger.setLevel(logging.INFO)
    logger.propagate = False  # the root logger has its own handler, for python-can
    try:
        yield
    finally:
        logger.removeHandler(PRINTING)
        logger.level, logger.propagate = before


@contextlib.contextmanager
def printed_without_waiting() -> Iterator[None]:
    """Within :func:`printed_log`: do not wait for a slow reader."""
    PRINTING.outputs = {stream: output for stream in (sys.stdout, sys.stderr) if (output := _output(stream))}
    try:
        yield
    finally:
        PRINTING.flush(PATIENCE_S)
        PRINTING.outputs = {}


class _Printing(logging.Handler):
    """Prints one line for each record; a failing output is an error of the command.

    ``as_json``: print JSON objects from now on.
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


PRINTING = _Printing()  # the only one in the process


def _output(stream: TextIO) -> LineOutput | None:
    """A non-blocking output; None on Windows, and if ``stream`` is not a file."""
    if sys.platform != "win32":
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
            return LineOutput(stream.fileno(), PRINTING.left_out, stream.encoding)
    return None


WIDTH = 30
CLEAR = "\r\x1b[K"
SOONEST_S = 2.0  # The remaining time is estimated after this time.
LINE_EVERY_S = 5.0  # Without a terminal, interval of progress lines of a long step.


@contextlib.contextmanager
def shown_progress(*, quiet: bool, interrupted: str = "") -> Iterator[Progress]:
    """Progress, removed at the end; ``interrupted``: message after an interruption."""
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
    """Shows one line per step, on a terminal with a bar, else from time to time. Never raises."""

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
        """Words on the remaining time; "" while it is uncertain."""
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
