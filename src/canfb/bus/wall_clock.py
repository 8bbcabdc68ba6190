"""The date and the time of day, for files and lines of a log."""

from __future__ import annotations

from datetime import datetime


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
