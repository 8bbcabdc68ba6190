"""The date and the time of day, for files and logs; the time that work takes, for people who wait."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import datetime

LEAST_PART = 0.01


def date_and_time() -> str:
    """Now, as reports have it (ISO 8601): yyyy-mm-dd hh:mm:ss and the offset to UTC."""
    return datetime.now().astimezone().isoformat(" ", "seconds")


def file_date_and_time() -> tuple[str, str]:
    """Now, as EDS and DCF have it (CiA 306): mm-dd-yyyy, and hh:mm with AM or PM."""
    now = datetime.now()
    return now.strftime("%m-%d-%Y"), now.strftime("%I:%M%p")


def local_time() -> datetime:
    """Now, with the offset of the local time to UTC."""
    return datetime.now().astimezone()


class Stopwatch:
    """Runs from the start; ``clock`` is that of the system, but for tests."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._begun_s = clock()

    def left_in_words(self, part: float) -> str:
        """How long the rest will take, of work of which ``part`` (0..1) is done; empty while nobody knows."""
        if part < LEAST_PART:
            return ""
        left_s = round((self._clock() - self._begun_s) * (1.0 - part) / part)
        minutes, seconds = divmod(left_s, 60)
        hours, minutes = divmod(minutes, 60)
        return f"{hours}:{minutes:02}:{seconds:02} left" if hours else f"{minutes}:{seconds:02} left"
