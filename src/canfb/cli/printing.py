"""Output of a command: lines on stdout and stderr, also of what the program logs while a command runs."""

from __future__ import annotations

import contextlib
import errno
import json
import logging
import os
import sys
from collections.abc import Iterator
from typing import TextIO

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
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


PATIENCE_S = 0.5  # at the end, for a reader


def print_as_json() -> None:
    """Lines of the log, from here to the end of the command, as JSON objects."""
    for one in _printing():
        one.as_json = True


def _printing() -> list[_Printing]:
    return [one for one in logging.getLogger("canfb").handlers if isinstance(one, _Printing)]


@contextlib.contextmanager
def printed_log() -> Iterator[None]:
    """Print what the loggers ``canfb.*`` say: information on stdout, warnings on stderr."""
    logger, handler = logging.getLogger("canfb"), _Printing()
    before = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    logger.propagate = False  # the root logger has a handler of its own, for python-can
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.level, logger.propagate = before


@contextlib.contextmanager
def printed_without_waiting() -> Iterator[None]:
    """Within :func:`printed_log`: the program does not wait for a reader that takes no lines."""
    printing = _printing()
    for one in printing:
        one.outputs = {
            stream: output for stream in (sys.stdout, sys.stderr) if (output := _output(stream, one))
        }
    try:
        yield
    finally:
        for one in printing:
            one.flush(PATIENCE_S)
            one.outputs = {}


class _Printing(logging.Handler):
    """One line for each record; an output that fails is an error of the command."""

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


def _output(stream: TextIO, printing: _Printing) -> LineOutput | None:
    """None on Windows, and for what is no file."""
    if sys.platform == "win32":
        return None
    try:
        descriptor = stream.fileno()
        stream.flush()
    except (OSError, ValueError):
        return None
    return LineOutput(descriptor, printing.left_out, stream.encoding)
