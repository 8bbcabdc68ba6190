"""What a command says: lines on stdout and stderr, and what the program logs meanwhile."""

from __future__ import annotations

import contextlib
import errno
import json
import logging
import os
import sys
from collections.abc import Iterator
from typing import TextIO


def report(text: str) -> None:
    """One line on stderr."""
    _print(f"canfb: {text}", sys.stderr)


def say(text: str) -> None:
    """One line on stdout, of a program that goes on after it."""
    _print(text, sys.stdout)


@contextlib.contextmanager
def printed_as_json() -> Iterator[None]:
    """Print what the loggers say as JSON on stdout, an object a line, within :func:`printed_log`.

    An event has its own values; what else there is to say is {"event": "message", "level": ..., "text": ...}.
    """
    printing = [one for one in logging.getLogger("canfb").handlers if isinstance(one, _Printing)]
    for one in printing:
        one.as_json = True
    try:
        yield
    finally:
        for one in printing:
            one.as_json = False


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


class _Printing(logging.Handler):
    """One line for each record; an output that fails is an error of the command."""

    as_json = False

    def emit(self, record: logging.LogRecord) -> None:
        """Print it."""
        if self.as_json:
            message = {"event": "message", "level": record.levelname.lower(), "text": record.getMessage()}
            say(json.dumps(getattr(record, "event", message), ensure_ascii=False))
            return
        (report if record.levelno >= logging.WARNING else say)(record.getMessage())


def _print(text: str, stream: TextIO) -> None:
    """Print at once. A reader or a terminal that has gone does not end the program: no more output there."""
    try:
        print(text, file=stream, flush=True)
    except OSError as error:
        if error.errno not in (errno.EPIPE, errno.EIO):
            raise
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
