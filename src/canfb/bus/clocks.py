"""The clock of durations, and the date and the time of day, for files and lines of a log."""

from __future__ import annotations

import os
import time
from datetime import UTC, datetime

from canfb.errors import ConfigError


def now_s() -> float:
    """Seconds since some moment; no setting of the time of day moves it."""
    return time.monotonic()


def date_and_time() -> str:
    """Now, as reports have it (ISO 8601): yyyy-mm-dd hh:mm:ss and the offset to UTC."""
    return datetime.now().astimezone().isoformat(" ", "seconds")


def page_date() -> str:
    """Of a page that can be made again, byte for byte: SOURCE_DATE_EPOCH (seconds since 1970, UTC), else now.

    ConfigError where that is no number of seconds.
    """
    said = os.environ.get("SOURCE_DATE_EPOCH")
    if said is None:
        return date_and_time()
    try:
        return datetime.fromtimestamp(int(said), UTC).isoformat(" ", "seconds")
    except (ValueError, OverflowError, OSError):
        raise ConfigError(f"SOURCE_DATE_EPOCH {said!r}: seconds since 1970 are required") from None


def file_date_and_time() -> tuple[str, str]:
    """Now, as EDS and DCF have it (CiA 306): mm-dd-yyyy, and hh:mm with AM or PM."""
    now = datetime.now()
    return now.strftime("%m-%d-%Y"), now.strftime("%I:%M%p")


def local_time() -> datetime:
    """Now, with the offset of the local time to UTC."""
    return datetime.now().astimezone()
